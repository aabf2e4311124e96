"""CPHD files by sarkit of the target that an aircraft flies past."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import flown_target as flight
import lxml.etree
import numpy as np
import sarkit.cphd
from scipy.constants import speed_of_light

NAMESPACE = "http://api.nsgreg.nga.mil/schema/cphd/1.1.0"
PULSES, PULSE_STEP = 255, 0.5
BANDWIDTH, FREQUENCIES = 150e6, 240
TIMES, OVERSAMPLED = 300, 1.25
"""Samples of a pulse in the domain TOA, and their rate over the bandwidth: they last as long as frequencies tell."""

SWATH_S = FREQUENCIES / BANDWIDTH / OVERSAMPLED

PVP = np.dtype(
    [
        ("TxTime", "f8"),
        *((name, "f8", 3) for name in ("TxPos", "TxVel")),
        ("RcvTime", "f8"),
        *((name, "f8", 3) for name in ("RcvPos", "RcvVel", "SRPPos")),
        *((name, "f8") for name in ("AmpSF", "aFDOP", "aFRR1", "aFRR2", "FX1", "FX2", "TOA1", "TOA2", "TDTropoSRP")),
        *((name, "f8") for name in ("SC0", "SCSS")),
        ("SIGNAL", "i8"),
    ]
)

CONVENTIONS: dict[str, dict[str, Any]] = {
    "FX": {},
    "FX, plus, whole numbers": {"sign": +1, "signal_format": "CI4"},
    "FX, wandering frequencies": {"wander_hz": 300e3},
    "FX, silent pulses": {"silent": 20},
    "TOA": {"domain": "TOA"},
    "TOA, plus, whole numbers, wandering": {"domain": "TOA", "sign": +1, "signal_format": "CI4", "wander_hz": 300e3},
}
"""Arguments of `write_cphd` for files by other conventions."""


def flown() -> np.ndarray:
    """Parameters of the pulses without those of the samples; the aircraft moves on until the echo arrives."""
    pvp = np.zeros(PULSES, PVP)
    pvp["TxTime"] = flight.BEGIN_S + (np.arange(PULSES) - PULSES // 2) * PULSE_STEP / flight.SPEED
    pvp["RcvTime"] = pvp["TxTime"] + 2 * flight.RANGE / speed_of_light
    for kind in ("Tx", "Rcv"):
        pvp[f"{kind}Pos"], pvp[f"{kind}Vel"] = flight.aircraft_at(pvp[f"{kind}Time"]), flight.velocity()
    pvp["SRPPos"], pvp["AmpSF"], pvp["SIGNAL"] = flight.to_space(np.zeros(3)), 1.0, 1
    pvp["TOA1"], pvp["TOA2"] = -SWATH_S / 2, SWATH_S / 2
    towards = pvp["TxPos"] - pvp["SRPPos"]
    closing = np.sum(towards * pvp["TxVel"], axis=-1) / np.linalg.norm(towards, axis=-1)
    pvp["aFDOP"] = -2 * closing / speed_of_light
    return pvp


def collected(domain: str, sign: int, wander_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of the pulses, and their samples: those of the target, by the way there and back between two times.

    The band moves from pulse to pulse by up to `wander_hz`. Over frequency, the phase is sign f d; over the time t of
    arrival it is the mean of that over the band, brought to baseband: a sinc, whose peak at t = d has the phase of the
    middle of the band (NGA.STND.0068, Global/SGN).
    """
    pvp = flown()
    way = sum(
        np.linalg.norm(pvp[f"{kind}Pos"] - flight.to_space(flight.TARGET), axis=-1)
        - np.linalg.norm(pvp[f"{kind}Pos"] - pvp["SRPPos"], axis=-1)
        for kind in ("Tx", "Rcv")
    )
    delay = np.asarray(way / speed_of_light)[:, None]
    middle = flight.CARRIER + wander_hz * np.sin(np.arange(PULSES) - PULSES // 2)
    if domain == "TOA":
        pvp["FX1"], pvp["FX2"] = middle - BANDWIDTH / 2, middle + BANDWIDTH / 2
        pvp["SCSS"] = 1 / (OVERSAMPLED * BANDWIDTH)
        pvp["SC0"] = -TIMES / 2 * pvp["SCSS"]
        time = pvp["SC0"][:, None] + pvp["SCSS"][:, None] * np.arange(TIMES)
        samples = np.exp(2j * np.pi * sign * middle[:, None] * delay) * np.sinc(BANDWIDTH * (time - delay))
    else:
        pvp["SCSS"] = BANDWIDTH / FREQUENCIES
        pvp["SC0"] = middle - (FREQUENCIES - 1) / 2 * pvp["SCSS"]
        pvp["FX1"], pvp["FX2"] = pvp["SC0"], pvp["SC0"] + (FREQUENCIES - 1) * pvp["SCSS"]
        frequency = pvp["SC0"][:, None] + pvp["SCSS"][:, None] * np.arange(FREQUENCIES)
        samples = np.exp(2j * np.pi * sign * frequency * delay)
    return pvp, samples.astype(np.complex64)


def metadata(pvp: np.ndarray, count: int, domain: str, sign: int, signal_format: str, channels: tuple[str, ...]) -> Any:
    """The XML root of a file of samples of that domain, `count` for each pulse."""
    root = lxml.etree.Element(f"{{{NAMESPACE}}}CPHD", nsmap={None: NAMESPACE})
    tree = sarkit.cphd.ElementWrapper(root)
    tree["CollectionID"] = {
        "CollectorName": "sensor",
        "CoreName": "test",
        "CollectType": "MONOSTATIC",
        "RadarMode": {"ModeType": "SPOTLIGHT"},
        "Classification": "UNCLASSIFIED",
        "ReleaseInfo": "UNRESTRICTED",
    }
    low, high = float(pvp["FX1"].min()), float(pvp["FX2"].max())
    tree["Global"] = {
        "DomainType": domain,
        "SGN": sign,
        "Timeline": {
            "CollectionStart": datetime(2026, 3, 1, 10, 0, 0, 500_000, UTC),
            "TxTime1": float(pvp["TxTime"][0]),
            "TxTime2": float(pvp["TxTime"][-1]),
        },
        "FxBand": {"FxMin": low, "FxMax": high},
        "TOASwath": {"TOAMin": -SWATH_S / 2, "TOAMax": SWATH_S / 2},
    }
    tree["SceneCoordinates"] = flight.scene_coordinates(100.0)
    size = {"CF8": 8, "CI4": 4}[signal_format] * pvp.size * count
    tree["Data"] = {
        "SignalArrayFormat": signal_format,
        "NumBytesPVP": pvp.dtype.itemsize,
        "NumCPHDChannels": len(channels),
        "Channel": [
            {
                "Identifier": name,
                "NumVectors": pvp.size,
                "NumSamples": count,
                "SignalArrayByteOffset": size * place,
                "PVPArrayByteOffset": pvp.nbytes * place,
            }
            for place, name in enumerate(channels)
        ],
        "NumSupportArrays": 0,
    }
    fixed = bool(np.ptp(pvp["FX1"]) == 0)
    tree["Channel"] = {
        "RefChId": channels[0],
        "FXFixedCPHD": fixed,
        "TOAFixedCPHD": True,
        "SRPFixedCPHD": True,
        "Parameters": [
            {
                "Identifier": name,
                "RefVectorIndex": pvp.size // 2,
                "FXFixed": fixed,
                "TOAFixed": True,
                "SRPFixed": True,
                "SignalNormal": bool(np.all(pvp["SIGNAL"] == 1)),
                "Polarization": {"TxPol": "V", "RcvPol": "V"},
                "FxC": (low + high) / 2,
                "FxBW": high - low,
                "TOASaved": SWATH_S,
                "DwellTimes": {"CODId": "middle", "DwellId": "all"},
            }
            for name in channels
        ],
    }
    words, layout = 0, {}
    for name in pvp.dtype.names or ():
        layout[name] = {"Offset": words, "Size": pvp.dtype[name].itemsize // 8, "dtype": pvp.dtype[name]}
        words += pvp.dtype[name].itemsize // 8
    tree["PVP"] = layout
    tree["Dwell"] = {
        "NumCODTimes": 1,
        "CODTime": [{"Identifier": "middle", "CODTimePoly": np.array([[flight.BEGIN_S]])}],
        "NumDwellTimes": 1,
        "DwellTime": [{"Identifier": "all", "DwellTimePoly": np.array([[float(np.ptp(pvp["TxTime"]))]])}],
    }
    tree["ReferenceGeometry"] = sarkit.cphd.compute_reference_geometry(root.getroottree(), pvp)
    return root


def write_cphd(
    path: Path,
    domain: str = "FX",
    sign: int = -1,
    signal_format: str = "CF8",
    wander_hz: float = 0.0,
    channels: tuple[str, ...] = ("VV",),
    silent: int = 0,
    without: tuple[str, ...] = (),
    parameters: Mapping[str, Any] | None = None,
    changes: Mapping[str, str] | None = None,
) -> Path:
    """A file by sarkit: the target in the first channel, nothing in others.

    Args:
        path: of the file.
        domain: FX or TOA.
        sign: of the phase (SGN).
        signal_format: of the samples: CF8 or CI4.
        wander_hz: by which the band moves from pulse to pulse.
        channels: their identifiers.
        silent: pulses at the end without a signal.
        without: names of parameters of pulses that the file does not have.
        parameters: values of parameters of the pulses, by name, in place of those of the flight.
        changes: texts of elements of the metadata, by the path from the root with / between names.
    """
    pvp, samples = collected(domain, sign, wander_hz)
    if silent:
        pvp["SIGNAL"][-silent:] = 0
        samples[-silent:] = 0
    if signal_format == "CI4":
        pvp["AmpSF"] = 1 / 2000
        whole = np.empty(samples.shape, [("real", "i2"), ("imag", "i2")])
        whole["real"], whole["imag"] = np.rint(2000 * samples.real), np.rint(2000 * samples.imag)
        samples = whole
    for name, values in (parameters or {}).items():
        pvp[name] = values
    root = metadata(pvp, samples.shape[1], domain, sign, signal_format, channels)
    for name in without:
        described = root.find("{*}PVP")
        described.remove(described.find(f"{{*}}{name}"))
    for place, text in (changes or {}).items():
        root.find("/".join(f"{{*}}{name}" for name in place.split("/"))).text = text
    kept = pvp[[name for name in PVP.names or () if name not in without]]
    tree = sarkit.cphd.Metadata(xmltree=root.getroottree())
    with path.open("wb") as file, sarkit.cphd.Writer(file, tree) as writer:
        for place, name in enumerate(channels):
            writer.write_signal(name, samples if place == 0 else np.zeros_like(samples))
            writer.write_pvp(name, kept)
    return path
