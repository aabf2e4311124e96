"""CRSD files by sarkit of the target that an aircraft flies past."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import flown_target as flight
import lxml.etree
import numpy as np
import sarkit.crsd
from scipy.constants import speed_of_light

NAMESPACE = "http://api.nsgreg.nga.mil/schema/crsd/1.0"
PULSES, PULSE_STEP = 255, 0.5
RATE, DURATION, BANDWIDTH = 200e6, 4e-6, 150e6
SAMPLES = 1200
NOISE_POWER = 1e-3
"""Of a sample of each of two beams; a target alone has no noise."""

OFF_CARRIER = 3e6
"""Carrier of the pulses over the frequency of the receiver, Hz."""

OF_PULSE = {
    "TxTime": 2,
    "TxPos": 3,
    "TxVel": 3,
    "FX1": 1,
    "FX2": 1,
    "TXmt": 1,
    "PhiX0": 2,
    "FxFreq0": 1,
    "FxRate": 1,
    "TxRadInt": 1,
    "TxACX": 3,
    "TxACY": 3,
    "TxEB": -2,
    "FxResponseIndex": 0,
}
OF_VECTOR = {
    "RcvStart": 2,
    "RcvPos": 3,
    "RcvVel": 3,
    "FRCV1": 1,
    "FRCV2": 1,
    "RefPhi0": 2,
    "RefFreq": 1,
    "DFIC0": 1,
    "FICRate": 1,
    "RcvACX": 3,
    "RcvACY": 3,
    "RcvEB": -2,
    "SIGNAL": 0,
    "AmpSF": 1,
    "DGRGC": 1,
    "TxPulseIndex": 0,
}
"""Parameters and their kinds: a whole number (0), a number, whole and fraction, three of space, or two cosines (-2)."""

KINDS: dict[int, np.dtype[Any]] = {
    0: np.dtype("i8"),
    1: np.dtype("f8"),
    2: np.dtype([("Int", "i8"), ("Frac", "f8")]),
    3: np.dtype(("f8", 3)),
    -2: np.dtype(("f8", 2)),
}

CONVENTIONS: dict[str, dict[str, Any]] = {
    "rising": {},
    "falling, early vectors, whole numbers": {"falling": True, "early_s": 0.2e-6, "signal_format": "CI4"},
    "vectors of noise, two channels": {"silent": 20, "channels": ("HH", "HV")},
}
"""Arguments of `write_crsd` for files by other conventions."""


def layout(parameters: Mapping[str, int]) -> dict[str, Any]:
    """The elements that describe the parameters of pulses or vectors."""
    offset, described = 0, {}
    for name, kind in parameters.items():
        size = max(1, abs(kind))
        described[name] = {
            "Offset": offset,
            "Size": size,
            "dtype": KINDS[kind],
        }
        offset += size
    return described


def whole_and_fraction(values: np.ndarray, out: np.ndarray) -> None:
    """Values as whole numbers and fractions from 0 to 1."""
    out["Int"] = np.floor(values)
    out["Frac"] = values - np.floor(values)


def flown(waveform_rate: float, arrival_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of the pulses and of the vectors, which begin a time after the middle of the pulse."""
    pulses = np.zeros(PULSES, [(name, KINDS[kind]) for name, kind in OF_PULSE.items()])
    vectors = np.zeros(PULSES, [(name, KINDS[kind]) for name, kind in OF_VECTOR.items()])
    sent = flight.BEGIN_S + (np.arange(PULSES) - PULSES // 2) * PULSE_STEP / flight.SPEED
    start = sent + np.round(arrival_s * RATE) / RATE
    whole_and_fraction(sent, pulses["TxTime"])
    whole_and_fraction(start, vectors["RcvStart"])
    pulses["TxPos"], vectors["RcvPos"] = flight.aircraft_at(sent), flight.aircraft_at(start)
    pulses["TxVel"] = vectors["RcvVel"] = flight.velocity()
    pulses["TXmt"], pulses["FxFreq0"], pulses["FxRate"] = DURATION, flight.CARRIER + OFF_CARRIER, waveform_rate
    pulses["FX1"] = pulses["FxFreq0"] - BANDWIDTH / 2
    pulses["FX2"] = pulses["FxFreq0"] + BANDWIDTH / 2
    whole_and_fraction(np.random.default_rng(1).uniform(0, 9, PULSES), pulses["PhiX0"])
    whole_and_fraction(np.random.default_rng(2).uniform(0, 9, PULSES), vectors["RefPhi0"])
    vectors["RefFreq"], vectors["AmpSF"], vectors["SIGNAL"] = flight.CARRIER, 1.0, 1
    vectors["FRCV1"], vectors["FRCV2"] = flight.CARRIER - RATE / 2, flight.CARRIER + RATE / 2
    vectors["TxPulseIndex"] = np.arange(PULSES)
    east, down = (flight.to_space_direction(np.array(axis)) for axis in ([1.0, 0.0, 0.0], [0.0, 0.0, -1.0]))
    for name, array in (("Tx", pulses), ("Rcv", vectors)):
        array[f"{name}ACX"], array[f"{name}ACY"] = east, down
    return pulses, vectors


def received(pulses: np.ndarray, vectors: np.ndarray, target: np.ndarray = flight.TARGET) -> np.ndarray:
    """Samples of the vectors: the pulse after its delay, brought to baseband by the receiver (NGA.STND.0080)."""
    sent, start = (array["Int"] + array["Frac"] for array in (pulses["TxTime"], vectors["RcvStart"]))
    after_start = np.arange(SAMPLES) / RATE
    wait = (vectors["RcvStart"]["Int"] - pulses["TxTime"]["Int"]) + (
        vectors["RcvStart"]["Frac"] - pulses["TxTime"]["Frac"]
    )
    assert np.allclose(start - sent, wait)
    late = (wait - flight.echo_delay(sent, target))[:, None] + after_start
    phase = pulses["PhiX0"]["Frac"][:, None] + pulses["FxFreq0"][:, None] * late
    phase += pulses["FxRate"][:, None] / 2 * late**2
    phase -= vectors["RefPhi0"]["Frac"][:, None] + vectors["RefFreq"][:, None] * after_start
    echo = np.where(np.abs(late) <= DURATION / 2, np.exp(2j * np.pi * phase), 0)
    return echo.astype(np.complex64)


def metadata(
    pulses: np.ndarray, vectors: np.ndarray, channels: tuple[str, ...], signal_format: str, changes: Mapping[str, Any]
) -> Any:
    """The XML tree of a file; `changes` are texts of elements, by the path from the root with / between names."""
    root = lxml.etree.Element(f"{{{NAMESPACE}}}CRSDsar", nsmap={None: NAMESPACE})
    tree = sarkit.crsd.ElementWrapper(root)
    sent, start = (array["Int"] + array["Frac"] for array in (pulses["TxTime"], vectors["RcvStart"]))
    middle, carrier = PULSES // 2, float(pulses["FxFreq0"][0])
    zero = {"ECF": flight.to_space(np.zeros(3)), "IAC": [0.0, 0.0]}
    tree["ProductInfo"] = {"ProductName": "test", "Classification": "UNCLASSIFIED", "ReleaseInfo": "UNRESTRICTED"}
    tree["SARInfo"] = {"CollectType": "MONOSTATIC", "RadarMode": {"ModeType": "SPOTLIGHT"}}
    tree["TransmitInfo"] = tree["ReceiveInfo"] = {"SensorName": "sensor", "EventName": "event"}
    tree["Global"] = {
        "CollectionRefTime": datetime(2026, 3, 1, 10, 0, 0, 500_000, UTC),
        "Transmit": {
            "TxTime1": float(sent[0]),
            "TxTime2": float(sent[-1]),
            "FxMin": carrier - BANDWIDTH / 2,
            "FxMax": carrier + BANDWIDTH / 2,
        },
        "Receive": {
            "RcvStartTime1": float(start[0]),
            "RcvStartTime2": float(start[-1]),
            "FrcvMin": float(vectors["FRCV1"][0]),
            "FrcvMax": float(vectors["FRCV2"][0]),
        },
    }
    tree["SceneCoordinates"] = flight.scene_coordinates(200.0)
    size = {"CF8": 8, "CI4": 4}[signal_format] * vectors.size * SAMPLES
    tree["Data"] = {
        "Support": {
            "NumSupportArrays": 2,
            "SupportArray": [
                {"SAId": "response", "NumRows": 1, "NumCols": 3, "BytesPerElement": 8, "ArrayByteOffset": 0},
                {"SAId": "gain", "NumRows": 3, "NumCols": 3, "BytesPerElement": 8, "ArrayByteOffset": 24},
            ],
        },
        "Transmit": {
            "NumBytesPPP": pulses.dtype.itemsize,
            "NumTxSequences": 1,
            "TxSequence": [{"TxId": "pulses", "NumPulses": pulses.size, "PPPArrayByteOffset": 0}],
        },
        "Receive": {
            "SignalArrayFormat": signal_format,
            "NumBytesPVP": vectors.dtype.itemsize,
            "NumCRSDChannels": len(channels),
            "Channel": [
                {
                    "ChId": name,
                    "NumVectors": vectors.size,
                    "NumSamples": SAMPLES,
                    "SignalArrayByteOffset": number * size,
                    "PVPArrayByteOffset": number * vectors.nbytes,
                }
                for number, name in enumerate(channels)
            ],
        },
    }
    tree["TxSequence"] = {
        "RefTxId": "pulses",
        "TxWFType": "LFM",
        "Parameters": [
            {
                "Identifier": "pulses",
                "RefPulseIndex": middle,
                "FxResponseId": "response",
                "FxBWFixed": True,
                "FxC": carrier,
                "FxBW": BANDWIDTH,
                "TXmtMin": DURATION,
                "TXmtMax": DURATION,
                "TxTime1": float(sent[0]),
                "TxTime2": float(sent[-1]),
                "TxAPCId": "centre",
                "TxAPATId": "pattern",
                "TxRefPoint": zero,
                "TxPolarization": polarization(pulses[middle], 1),
                "TxRefRadIntensity": 0.0,
                "TxRadIntErrorStdDev": 0.0,
                "TxRefLAtm": 0.0,
            }
        ],
    }
    tree["Channel"] = {
        "RefChId": channels[0],
        "Parameters": [
            {
                "Identifier": name,
                "RefVectorIndex": middle,
                "RefFreqFixed": True,
                "FrcvFixed": True,
                "SignalNormal": bool(np.all(vectors["SIGNAL"] == 1)),
                "F0Ref": float(vectors["RefFreq"][middle]),
                "Fs": RATE,
                "BWInst": RATE / 1.1,
                "RcvStartTime1": float(start[0]),
                "RcvStartTime2": float(start[-1]),
                "FrcvMin": float(vectors["FRCV1"][0]),
                "FrcvMax": float(vectors["FRCV2"][0]),
                "RcvAPCId": "centre",
                "RcvAPATId": "pattern",
                "RcvRefPoint": zero,
                "RcvPolarization": polarization(vectors[middle], -1),
                "RcvRefIrradiance": 0.0,
                "RcvIrradianceErrorStdDev": 0.0,
                "RcvRefLAtm": 0.0,
                "PNCRSD": NOISE_POWER,
                "BNCRSD": 1.0,
                "SARImage": {
                    "TxId": "pulses",
                    "RefVectorPulseIndex": middle,
                    "TxPolarization": polarization(pulses[middle], 1),
                    "DwellTimes": {"Polynomials": {"CODId": "middle", "DwellId": "all"}},
                    "ImageArea": flight.image_area(200.0),
                },
            }
            for name in channels
        ],
    }
    tree["DwellPolynomials"] = {
        "NumCODTimes": 1,
        "CODTime": [{"Identifier": "middle", "CODTimePoly": np.array([[flight.BEGIN_S]])}],
        "NumDwellTimes": 1,
        "DwellTime": [{"Identifier": "all", "DwellTimePoly": np.array([[float(sent[-1] - sent[0])]])}],
    }
    tree["SupportArray"] = {
        "GainPhaseArray": [
            {
                "Identifier": "gain",
                "ElementFormat": "Gain=F4;Phase=F4;",
                "X0": -1.0,
                "Y0": -1.0,
                "XSS": 1.0,
                "YSS": 1.0,
            }
        ],
        "FxResponseArray": [
            {
                "Identifier": "response",
                "ElementFormat": "Amp=F4;Phase=F4;",
                "Fx0FXR": carrier - BANDWIDTH,
                "FxSSFXR": BANDWIDTH,
            }
        ],
    }
    tree["PPP"], tree["PVP"] = layout(OF_PULSE), layout(OF_VECTOR)
    tree["Antenna"] = {
        "NumACFs": 1,
        "NumAPCs": 1,
        "NumAPATs": 1,
        "AntCoordFrame": [{"Identifier": "axes"}],
        "AntPhaseCenter": [{"Identifier": "centre", "ACFId": "axes", "APCXYZ": [0.0, 0.0, 0.0]}],
        "AntPattern": [
            {
                "Identifier": "pattern",
                "FreqZero": carrier,
                "ArrayGPId": "gain",
                "ElemGPId": "gain",
                "EBFreqShift": {"DCXSF": 0.0, "DCYSF": 0.0},
                "MLFreqDilation": {"DCXSF": 0.0, "DCYSF": 0.0},
                "GainBSPoly": np.array([0.0]),
                "AntPolRef": {"AmpX": 1.0, "AmpY": 0.0, "PhaseX": 0.0, "PhaseY": 0.0},
            }
        ],
    }
    geometry = sarkit.crsd.compute_reference_geometry(root.getroottree(), pvps=vectors, ppps=pulses)
    tree["ReferenceGeometry"] = geometry
    for path, text in changes.items():
        root.find("/".join(f"{{*}}{name}" for name in path.split("/"))).text = text
    return root.getroottree()


def halved(samples: np.ndarray) -> np.ndarray:
    """Half of samples, which are complex or whole numbers in pairs."""
    half = np.empty_like(samples)
    if not samples.dtype.names:
        return samples / np.complex64(2)
    for name in samples.dtype.names:
        half[name] = samples[name] // 2
    return half


def polarization(parameters: np.ndarray, direction: int) -> dict[str, Any]:
    """The polarisation of waves along the flight, seen from the reference point: +1 transmitted, -1 received."""
    name = "Tx" if direction > 0 else "Rcv"
    axes = parameters[f"{name}ACX"], parameters[f"{name}ACY"]
    point = flight.to_space(np.zeros(3))
    h, v, phase_h, phase_v = sarkit.crsd.compute_h_v_pol_parameters(
        parameters[f"{name}Pos"], *axes, point, direction, 1.0, 0.0, 0.0, 0.0
    )
    return {"PolarizationID": "H", "AmpH": h, "AmpV": v, "PhaseH": phase_h, "PhaseV": phase_v}


BEAM_OFFSETS, BEAMWIDTH = (-0.006, 0.006), 0.03
"""Boresights of two beams against the angle of the reference point, and their wavelength over diameter, rad."""

GRID = np.linspace(-0.06, 0.06, 601)
"""Offsets in direction cosines at which the pattern of the array is stated."""


def amplitude(offset: np.ndarray) -> np.ndarray:
    """Of a beam, over the offset in direction cosines along its array."""
    return np.sinc(offset / BEAMWIDTH)


def write_beams(path: Path, target: np.ndarray) -> Path:
    """A file by sarkit of two channels, whose beams differ in elevation: the target, as each of them receives it.

    The lower channel of the file has the upper beam.
    """
    arrival = 2 * flight.RANGE / speed_of_light - (SAMPLES - 1) / 2 / RATE
    pulses, vectors = flown(BANDWIDTH / DURATION, arrival)
    samples, down = received(pulses, vectors, target), vectors["RcvACY"][0]
    towards = flight.to_space(target) - vectors["RcvPos"]
    cosine = towards @ down / np.linalg.norm(towards, axis=-1)
    tree = metadata(pulses, vectors, ("up", "down"), "CF8", {})
    array = tree.find("{*}SupportArray/{*}GainPhaseArray")
    root = sarkit.crsd.ElementWrapper(tree.getroot())
    root["SupportArray"]["GainPhaseArray"] += (
        {
            "Identifier": "array",
            "ElementFormat": "Gain=F4;Phase=F4;",
            "X0": -1.0,
            "Y0": float(GRID[0]),
            "XSS": 1.0,
            "YSS": float(GRID[1] - GRID[0]),
        },
    )
    assert array is not None
    rows = {"SAId": "array", "NumRows": 3, "NumCols": GRID.size, "BytesPerElement": 8, "ArrayByteOffset": 96}
    root["Data"]["Support"]["SupportArray"] += (rows,)
    root["Data"]["Support"]["NumSupportArrays"] = 3
    tree.find("{*}Antenna/{*}AntPattern/{*}ArrayGPId").text = "array"
    gain = np.zeros((3, GRID.size), [("Gain", "f4"), ("Phase", "f4")])
    with np.errstate(divide="ignore"):
        gain["Gain"] = np.maximum(20 * np.log10(np.abs(amplitude(GRID))), -80.0)
    with path.open("wb") as file, sarkit.crsd.Writer(file, sarkit.crsd.Metadata(xmltree=tree)) as writer:
        writer.write_support_array("response", np.array([[(1, 0)] * 3], [("Amp", "f4"), ("Phase", "f4")]))
        writer.write_support_array("gain", np.zeros((3, 3), [("Gain", "f4"), ("Phase", "f4")]))
        writer.write_support_array("array", gain)
        writer.write_ppp("pulses", pulses)
        rng = np.random.default_rng(3)
        for name, offset in zip(("up", "down"), BEAM_OFFSETS[::-1], strict=True):
            vectors["RcvEB"][:, 1] = np.cos(flight.ELEVATION + offset)
            heard = amplitude(cosine - vectors["RcvEB"][:, 1])[:, None]
            noise = rng.normal(0, np.sqrt(NOISE_POWER / 2), (*samples.shape, 2)).view(np.complex128)[..., 0]
            writer.write_signal(name, (heard * samples + noise).astype(np.complex64))
            writer.write_pvp(name, vectors)
    return path


def write_crsd(
    path: Path,
    channels: tuple[str, ...] = ("HH",),
    signal_format: str = "CF8",
    falling: bool = False,
    silent: int = 0,
    early_s: float = 0.0,
    parameters: Mapping[str, Any] | None = None,
    changes: Mapping[str, Any] | None = None,
) -> Path:
    """A file by sarkit: the target in the first channel, and at half the amplitude in others.

    Args:
        path: of the file.
        channels: their identifiers.
        signal_format: of the samples: CF8 or CI4.
        falling: whether the frequency of the pulses falls.
        silent: vectors at the end that hold noise alone, of no pulse.
        early_s: time by which vectors begin earlier than puts the echo from the reference point into their middle.
        parameters: values of parameters of pulses or vectors, by name, in place of those of the flight.
        changes: texts of elements of the metadata, by path.
    """
    arrival = 2 * flight.RANGE / speed_of_light - (SAMPLES - 1) / 2 / RATE - early_s
    pulses, vectors = flown((-1 if falling else 1) * BANDWIDTH / DURATION, arrival)
    samples = received(pulses, vectors)
    if silent:
        vectors["SIGNAL"][-silent:], vectors["TxPulseIndex"][-silent:] = 2, -1
        samples[-silent:] = 1000.0
    if signal_format == "CI4":
        vectors["AmpSF"] = 1 / 2000
        whole = np.empty(samples.shape, [("real", "i2"), ("imag", "i2")])
        whole["real"], whole["imag"] = np.rint(2000 * samples.real), np.rint(2000 * samples.imag)
        samples = whole
    for name, values in (parameters or {}).items():
        (pulses if name in OF_PULSE else vectors)[name] = values
    tree = metadata(pulses, vectors, channels, signal_format, changes or {})
    with path.open("wb") as file, sarkit.crsd.Writer(file, sarkit.crsd.Metadata(xmltree=tree)) as writer:
        writer.write_support_array("response", np.array([[(1, 0)] * 3], [("Amp", "f4"), ("Phase", "f4")]))
        writer.write_support_array("gain", np.zeros((3, 3), [("Gain", "f4"), ("Phase", "f4")]))
        writer.write_ppp("pulses", pulses)
        for place, name in enumerate(channels):
            writer.write_signal(name, samples if place == 0 else halved(samples))
            writer.write_pvp(name, vectors)
    return path
