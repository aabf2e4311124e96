"""Provenance: what a product was made from, by which version of the program and with which parameters."""

from __future__ import annotations

import math
import pickle
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from sal_height import __version__
from sal_height.errors import Rejected
from sal_height.imaging import Centroid, Placement, Slc
from sal_height.numeric import F32, WINDOWS
from sal_height.settings import Settings

COMPRESSION = "sar_compression"
"""Stage whose parameters say how the images were formed."""

LEFT_OUT = "channels_left_out"
"""Name, in addition to the parameters of an estimator, of the channels without a signal; only if there are any."""

PLACEMENT, RESIDUAL = "placement", "residual.phase_rad"
"""Names, or prefixes, in addition to the parameters of the compression; the others are those of `Placement`."""

CACHED = 16
"""Provenances whose successors are cached: the products of a stage share the same objects."""

Cached = TypeVar("Cached")


class Same(Generic[Cached]):
    """An object that is never changed, as a key: equal to nothing but itself."""

    __slots__ = ("one",)

    def __init__(self, one: Cached) -> None:
        self.one = one

    def __hash__(self) -> int:
        """By identity, which lasts as long as this key refers to the object."""
        return id(self.one)

    def __eq__(self, other: object) -> bool:
        """True if it is the very same object."""
        return isinstance(other, Same) and other.one is self.one


@dataclass(frozen=True, eq=False)
class Provenance:
    """Record of how a product was made; never changed once it is made.

    Attributes:
        code_version: version of the package that made the product.
        config_hash: identity of the sensor's description.
        calibration_id: identity of the calibration that was applied; empty: none.
        parameters: values of the parameters of all stages so far, by "stage.name", in the order of the stages: truth
            values, whole numbers, numbers, texts, bytes, or tuples of one of these.
        autofocus_phase: phase that autofocus removed from each pulse, rad, float32, shape (pulses,); empty: none.
    """

    code_version: str = ""
    config_hash: str = ""
    calibration_id: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    autofocus_phase: F32 = field(default_factory=lambda: np.zeros(0, np.float32))

    def __eq__(self, other: object) -> bool:
        """True if two provenances state the same."""
        return self is other or (
            isinstance(other, Provenance)
            and (self.code_version, self.config_hash, self.calibration_id)
            == (other.code_version, other.config_hash, other.calibration_id)
            and self.parameters == other.parameters
            and np.array_equal(self.autofocus_phase, other.autofocus_phase)
        )

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        """To be sent to another process, where those that state the same are the same object, too."""
        return _received, (self._pickled,)

    @cached_property
    def _pickled(self) -> bytes:
        """All that it states, as one object."""
        stated = self.code_version, self.config_hash, self.calibration_id, dict(self.parameters), self.autofocus_phase
        return pickle.dumps(stated, protocol=5)

    @cached_property
    def stages(self) -> Mapping[str, Mapping[str, Any]]:
        """Values by stage and name of the parameter."""
        stages: dict[str, dict[str, Any]] = {}
        for full, value in self.parameters.items():
            stage, _, name = full.partition(".")
            stages.setdefault(stage, {})[name] = value
        return stages

    @property
    def compression(self) -> Mapping[str, Any]:
        """Values stated for the compression, by name; empty: none."""
        return self.stages.get(COMPRESSION, {})

    def window(self, axis: str) -> str:
        """Name of the window that the images were made with; "rectangular" if none of `numeric.WINDOWS` is stated.

        Args:
            axis: "range" or "azimuth".
        """
        name = self.compression.get(f"{axis}_window")
        return name if isinstance(name, str) and name in WINDOWS else "rectangular"

    @cached_property
    def placement(self) -> Placement:
        """Placement of the image relative to odometry.

        Raises:
            Rejected: a number that is stated is invalid.
        """
        names = "speed", "pointing", "speed_error", "beams_error", "own_error"
        speed, pointing, error, beams_error, own_error = (self._number(f"{PLACEMENT}.{name}") for name in names)
        found = [self._number(f"{PLACEMENT}.centroid.{name}") for name in ("speed", "error", "vibration")]
        centroid = Centroid(*found) if f"{PLACEMENT}.centroid.speed" in self.compression else None
        by_beams = bool(self.compression.get(f"{PLACEMENT}.by_beams", False))
        return Placement(speed, pointing, error, centroid, by_beams, beams_error, own_error)

    @property
    def residual_phase(self) -> float:
        """Standard deviation of the phase of each pulse that autofocus leaves, rad.

        Raises:
            Rejected: the number that is stated is invalid.
        """
        return self._number(RESIDUAL)

    def derived(self, stage: str, values: Settings | Mapping[str, Any]) -> Provenance:
        """The provenance of what a stage made of a product with this one.

        That of the same settings is the same object. Sensor, calibration and autofocus phase are kept.

        Args:
            stage: name of the stage or of its node, before the first dot in the names of its parameters; what is stated
                of a stage of this name is replaced.
            values: values of its parameters, by name. Nested mappings make names with further dots; None is left out.
        """
        if isinstance(values, Settings):
            return _derived(Same(self), stage, Same(values))
        return _newly_derived(self, stage, values)

    def stating(self, prefix: str, values: Mapping[str, Any]) -> Provenance:
        """The provenance with further values, by names that begin with the prefix; none of them is stated yet."""
        return replace(self, parameters={**self.parameters, **flat_values(values, prefix)})

    def _number(self, name: str) -> float:
        value = self.compression.get(name, 0.0)
        least = 0.0 if name.endswith(("error", "vibration", RESIDUAL)) else -math.inf
        if not isinstance(value, int | float) or not math.isfinite(value) or value < least:
            raise Rejected(
                "wrong provenance",
                f"Provenance.parameters has {value!r} for {COMPRESSION}.{name}; finite numbers are allowed, and "
                "errors, vibrations and phases of 0 or more.",
            )
        return float(value)


def of_compression(
    stage: str,
    values: Settings | Mapping[str, Any],
    slc: Slc,
    config_hash: str,
    calibration_id: str,
) -> Provenance:
    """The provenance of images; of dwells that state the same it is the same object.

    Args:
        stage: name of the compression or of its node.
        values: values of its parameters.
        slc: images, with what autofocus found.
        config_hash: identity of the sensor's description.
        calibration_id: identity of the calibration that was applied; empty: none.
    """
    stated = flat_values({**dict(values), **autofocus_values(slc)}, f"{stage}.")
    return _restored(__version__, config_hash, calibration_id, stated, slc.autofocus_phase)


def autofocus_values(slc: Slc) -> dict[str, Any]:
    """Values of autofocus in a provenance, in addition to the compression's parameters; empty if there was none."""
    placed = slc.placement.centroid or slc.placement.by_beams
    return {
        **({PLACEMENT: asdict(slc.placement)} if placed else {}),
        **({RESIDUAL: slc.residual_phase} if slc.residual_phase else {}),
    }


class _Stated:
    """A provenance as a key: equal to those that state the same, to the last bit and with the same types."""

    __slots__ = ("one", "text")

    def __init__(self, one: Provenance) -> None:
        self.one = one
        phase = one.autofocus_phase.tobytes()
        self.text = repr((one.code_version, one.config_hash, one.calibration_id, one.parameters, phase))

    def __hash__(self) -> int:
        return hash(self.text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Stated) and other.text == self.text


def _restored(
    code_version: str, config_hash: str, calibration_id: str, parameters: Mapping[str, Any], phase: npt.ArrayLike
) -> Provenance:
    """The provenance that states this: the same object for the same, of those that were used last.

    The phase is copied, for it may lie in memory that is used again.
    """
    kept = np.array(phase, np.float32)
    return _first_alike(_Stated(Provenance(code_version, config_hash, calibration_id, parameters, kept)))


@lru_cache(CACHED)
def _received(pickled: bytes) -> Provenance:
    """The provenance that another process has sent."""
    return _restored(*pickle.loads(pickled))  # noqa: S301 (a process of ours wrote it)


@lru_cache(CACHED)
def _first_alike(stated: _Stated) -> Provenance:
    """The first of the provenances that state the same."""
    return stated.one


@lru_cache(CACHED)
def _derived(before: Same[Provenance], stage: str, values: Same[Settings]) -> Provenance:
    return _newly_derived(before.one, stage, values.one)


def _newly_derived(before: Provenance, stage: str, values: Settings | Mapping[str, Any]) -> Provenance:
    kept = {name: value for name, value in before.parameters.items() if not name.startswith(f"{stage}.")}
    parameters = {**kept, **flat_values(values, f"{stage}.")}
    return Provenance(__version__, before.config_hash, before.calibration_id, parameters, before.autofocus_phase)


def flat_values(values: Settings | Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values as a provenance states them, by names that begin with the prefix; None is left out, lists are tuples."""
    flat: dict[str, Any] = {}
    for name, value in dict(values).items():
        if isinstance(value, Settings | Mapping):
            flat |= flat_values(value, f"{prefix}{name}.")
        elif value is not None:
            flat[prefix + name] = _plain(value)
    return flat


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    return tuple(value) if isinstance(value, list) else value
