"""Names that documents, notebooks and the pytest plugin imported in an earlier state can be imported still."""

from __future__ import annotations

import importlib
import warnings

import pytest

DOCUMENTED = {
    "sal_height": "open_heights",
    "sal_height.beams": "PATTERNS Beams column_squint pattern_named",
    "sal_height.calibration": "Calibration Calibrator",
    "sal_height.elevation": "ESTIMATORS MlSettings Validity common_deviation discriminant look_grid ml_elevation"
    " products sidelobe_variance speckle_crb stochastic_crb total_least_squares windowed_looks",
    "sal_height.figures.sample_statistics": "mean median s68 share std",
    "sal_height.figures.unit_arrays": "array_of",
    "sal_height.geometry": "ApertureState Grid Trajectory angles_of locate_at_height sphere_coordinates",
    "sal_height.imaging": "ImageSettings azimuth_resolution cell_response image_beams",
    "sal_height.imports": "Collection level_states read_description read_gotcha write_collection",
    "sal_height.messages": "field_from_message",
    "sal_height.numeric": "C64 F64",
    "sal_height.pipeline": "Compressor elevations heights heights_of_dwells",
    "sal_height.relief": "PriorEstimate ReliefMap TrackingSettings fitting_cell_size height_field height_variance"
    " track",
    "sal_height.relief.position_error": "pose_covariance position_jacobian vertical",
    "sal_height.response": "measure_brightest",
    "sal_height.sensor": "Channels PhaseHistory",
    "sal_height.simulation": "Impairments Preset flight_of load_preset truth_image",
    "sal_height.simulation.lit_surfaces": "lit_surfaces",
    "sal_height.tables": "aligned",
    "sal_height.theory": "TargetPixels cnr_detector_of gaussian_law s68_of",
}
"""Modules that have stayed where they were, and their names."""

MOVED = {
    "sal_height.nodes.stage": "FRAMES_QOS LATCHED_QOS ODOMETRY_QOS",
    "sal_height.elevation.bounds": "information",
    "sal_height.runs.comparison": "Comparison FOUND_ORDERS TRUE_ORDERS compare joined_comparisons",
    "sal_height.runs.judge": "verdict_of",
    "sal_height.runs.replay": "Against Replay replay",
}
"""Modules whose names are elsewhere, and work here with a warning."""


@pytest.mark.parametrize("module", DOCUMENTED)
def test_documented_names_stay_where_they_are(module: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not [name for name in DOCUMENTED[module].split() if not hasattr(importlib.import_module(module), name)]


@pytest.mark.parametrize(("module", "name"), [(module, name) for module in MOVED for name in MOVED[module].split()])
def test_moved_names_work_with_a_warning_that_says_where_they_are(module: str, name: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"{module}.{name} has moved to sal_height\.") as warned:
        found = getattr(importlib.import_module(module), name)
    new, _, renamed = str(warned[0].message).split(" has moved to ")[1].split(";")[0].partition(" as ")
    assert getattr(importlib.import_module(new), renamed or name) is found


def test_a_moved_module_has_no_other_names() -> None:
    with pytest.raises(AttributeError, match=r"sal_height\.runs\.replay.* has no attribute 'reply'"):
        importlib.import_module("sal_height.runs.replay").reply  # noqa: B018
