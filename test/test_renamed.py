"""Old names of parameters and values are read everywhere with the new ones, and refused by nodes with a hint."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import Graph
from helpers import refused
from rclpy.parameter import Parameter

from sal_height.bag.files import PARAMETERS as CUSTOM
from sal_height.bag.reader import BagReader
from sal_height.budget.budget_errors import image_settings
from sal_height.commands._options import node_parameters
from sal_height.engine.registry import STAGES
from sal_height.errors import UserError
from sal_height.graph.catalogue import check_parameters
from sal_height.graph.node_classes import PROCESSING
from sal_height.graph.reporting import merged
from sal_height.renamed import PARAMETERS, VALUES, with_new_names
from sal_height.runs.campaign.batch import Campaign
from sal_height.runs.chain.recorded_parameters import (
    CUSTOM_DATA,
    RecordedParameters,
    recorded_at_start,
    recorded_parameters,
)
from sal_height.runs.chain.timeline import timeline_of
from sal_height.settings import settings_of, unknown_name
from sal_height.simulation import load_preset

BAG = Path(__file__).parents[1] / "bags" / "version_3"


def test_old_names_are_of_no_parameter_today_and_new_ones_are() -> None:
    today = {name for stage in STAGES.values() for name in settings_of(stage.settings)}
    assert not today & PARAMETERS.keys()
    assert set(PARAMETERS.values()) <= today
    for name, values in VALUES.items():
        entries = [
            settings_of(stage.settings)[name] for stage in STAGES.values() if name in settings_of(stage.settings)
        ]
        assert entries
        assert not set(values) & {choice for entry in entries for choice in entry.choices}


def test_old_names_and_values_become_new_ones_and_new_ones_win() -> None:
    old = {"odometry_held_s": 5.0, "air": "heard", "autofocus": True, "cols": 1}
    assert with_new_names(old) == {"odometry_buffer_s": 5.0, "air": "topics", "autofocus": "always", "cols": 1}
    assert with_new_names({"odometry_held_s": 5.0, "odometry_buffer_s": 6.0}) == {"odometry_buffer_s": 6.0}
    assert with_new_names({"cols": 1, "order": True}) == {"cols": 1, "order": True}


def test_presets_options_and_campaigns_take_old_names() -> None:
    """All of these are checked by one function."""
    checked = check_parameters({"sar_compression": {"odometry_held_s": 5, "air": "heard"}})
    assert checked == {"sar_compression": {"odometry_buffer_s": 5.0, "air": "topics"}}


def test_old_names_of_the_user_replace_new_ones_of_the_bag() -> None:
    """Both are merged before they are checked."""
    recorded: dict[str, dict[str, Any]] = {"ml_height": {"misfit_fraction": 0.03}, "sar_compression": {"air": "topics"}}
    given: dict[str, dict[str, Any]] = {"ml_height": {"misfit_share": 0.2}, "sar_compression": {"air": "none"}}
    assert check_parameters(merged(recorded, given)) == {
        "ml_height": {"misfit_fraction": 0.2},
        "sar_compression": {"air": "none"},
    }
    assert node_parameters(["ml_height.misfit_share=0.2"]) == {"ml_height": {"misfit_fraction": 0.2}}
    bag = RecordedParameters(BAG, recorded, {}, {})
    assert bag.check(recorded, given)["ml_height"] == {"misfit_fraction": 0.2}


def test_a_campaign_varies_parameters_by_old_names() -> None:
    campaign = Campaign((BAG,), {"ml_height": {"misfit_fraction": 0.1}}, {"ml_height.misfit_share": [0.2, 0.3]})
    values = [case.given["ml_height"] for case in campaign.cases(Path("out"))]
    assert values == [{"misfit_fraction": 0.2}, {"misfit_fraction": 0.3}]


def test_budgets_take_old_values_of_presets() -> None:
    preset = replace(load_preset("small"), processing={"sar_compression": {"autofocus": True}})
    assert image_settings(preset).autofocus == "always"


@pytest.mark.parametrize("as_file", [True, False], ids=["parameters.yaml", "custom data"])
def test_bags_that_state_old_names_are_read_with_new_ones(as_file: bool, tmp_path: Path) -> None:
    bag = tmp_path / "run" / "bag"
    shutil.copytree(BAG, bag)
    stated = json.dumps({"psf_calibration": {"misfit_share": 0.07}, "sar_compression": {"autofocus": False}})
    if as_file:
        (bag / "parameters.yaml").write_text(stated)
    reader = BagReader(bag)
    reader.custom_data = {} if as_file else {CUSTOM: stated}
    values = recorded_parameters(reader)
    assert values["psf_calibration"] == {"misfit_fraction": 0.07}
    assert values["sar_compression"]["autofocus"] == "never"
    assert "odometry_buffer_s" in values["sar_compression"], "stated by the provenance of the heights"
    assert not PARAMETERS.keys() & values["sar_compression"].keys()


@pytest.mark.parametrize(("strength", "is_reported"), [(0.0, False), (0.75, True)])
def test_a_parameter_that_has_ended_is_left_out_and_reported_where_it_changed_heights(
    strength: float, is_reported: bool, tmp_path: Path
) -> None:
    reader = BagReader(shutil.copytree(BAG, tmp_path / "bag"))
    reader.custom_data = {CUSTOM: json.dumps({"ml_height": {"prior_strength": strength}})}
    timeline = timeline_of(reader)
    assert "prior_strength" not in recorded_at_start(reader, timeline).values["ml_height"]
    assert (timeline.forgotten.get(("ml_height", "prior_strength")) == CUSTOM_DATA) == is_reported


def test_a_node_refuses_old_names_and_values_and_names_the_new(graph: Graph) -> None:
    sentence = unknown_name("odometry_held_s", settings_of(STAGES["sar_compression"].settings), "Node x")
    assert sentence == "Parameter 'odometry_held_s' of node x is named 'odometry_buffer_s' now."
    with refused(UserError, "'heard'", "is named 'topics' now"):
        PROCESSING["sar_compression"](context=graph.context, parameter_overrides=[Parameter("air", value="heard")])
