"""Files that stages read before the start, and that they write."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sal_height.adjustment import read_targets
from sal_height.calibration import Calibration, load_calibration, save_calibration
from sal_height.engine.mapper import PlacedRelief
from sal_height.engine.results import FileProduct
from sal_height.engine.stage import Stage
from sal_height.geometry.elevation_model import read_elevation_model
from sal_height.relief import check_geotiff, write_geotiff

READERS: Mapping[str, Callable[[Path], Any]] = {
    "calibration": load_calibration,
    "elevation model": lambda path: read_elevation_model(path).heights,
    "targets": read_targets,
}
"""Functions that read a file, by its content (`engine.stage.FileInput.kind`)."""


def read_inputs(stage: type[Stage], settings: Any) -> dict[str, Any]:
    """The contents of the files that a stage needs, by name.

    Raises:
        UserError: a file cannot be read.
    """
    return {one.name: READERS[one.kind](Path(one.path)) for one in stage.files(settings)}


def check_written(stage: type[Stage], settings: Any) -> None:
    """Refuse files that could not be written at the end.

    Raises:
        UserError: there is one.
    """
    for kind, path in stage.written_files(settings):
        if kind is PlacedRelief:
            check_geotiff(Path(path))


def write_product(product: FileProduct) -> None:
    """Write what a stage has made for a file.

    Raises:
        UserError: it cannot be written.
    """
    path, item = Path(product.path), product.item
    if isinstance(item, Calibration):
        save_calibration(path, item)
    elif isinstance(item, PlacedRelief):
        provenance = item.provenance
        tags = {
            "estimator": item.estimator,
            "images": str(item.images),
            **{key: getattr(provenance, key) for key in ("code_version", "config_hash", "calibration_id")},
            "parameters": json.dumps(provenance.stages, sort_keys=True),
        }
        write_geotiff(path, item.relief, item.projection, item.key.stamp_ns, tags)
    else:
        raise TypeError(f"nothing writes a {type(item).__name__}")
