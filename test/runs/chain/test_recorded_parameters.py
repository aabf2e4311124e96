"""Parameters of a replay: all values that a bag states, also defaults of its time, and those that users set."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence, refused
from pydantic import create_model
from written_bag import calibration, changed, frame, heights, key, told, written, written_apart

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.engine.compression import HEARD
from sal_height.engine.registry import STAGES as KINDS
from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.graph.catalogue import SETTABLE, consumers, parameters_of
from sal_height.graph.plan import DwellChanges
from sal_height.messages.types import ComplexImage
from sal_height.renamed import BEFORE, with_new_names
from sal_height.runs.chain.chain_runs import plan
from sal_height.runs.chain.entry import FROM_HEIGHTS, IMAGES, WHOLE, Part, ReplayNodes, chain_of
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.chain.replay_parameters import ReplayPlan, processing_of
from sal_height.runs.chain.timeline import OF_MACHINE
from sal_height.runs.live.sensor_bag import Feed
from sal_height.sensor import AS_DESCRIBED
from sal_height.settings import settings_of
from sal_height.simulation import load_preset

BAGS = Path(__file__).parents[3] / "bags"
ALL = sorted(folder.name for folder in BAGS.iterdir() if folder.is_dir())

STAGES = ["sar_compression", "ml_height", "relief_tracker"]
CHAIN = ReplayNodes("phase_history", ["ml_height"], STAGES, 1, ["/phase_history"])

OTHER = {
    "sar_compression": {"range_window": "hamming", "azimuth_window": "hamming", "ground_spacing_m": 2.0, "rows": 8},
    "ml_height": {"min_cnr_db": 22.0, "layover": False, "max_sigma_beamwidths": 0.01, "timeout_s": 7.0},
    "monopulse": {"min_cnr_db": 22.0, "discriminant": "ratio"},
    "sum_difference_height": {"inverse": "linear"},
    "canopy_ground_height": {"min_cnr_db": 22.0, "azimuth_looks": 3},
    "relief_tracker": {"gate": 2.0, "along_track": False},
}
"""Defaults that no bag was recorded with."""


def exact_then(node: str) -> dict[str, float]:
    """Standard deviations that a bag was recorded without, when nothing was assumed of them."""
    entries = settings_of(KINDS[node].settings).values()
    return {entry.name: 0.0 for entry in entries if entry.default == AS_DESCRIBED}


@pytest.fixture
def other_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nodes whose defaults are `OTHER`."""
    for node, defaults in OTHER.items():
        model = KINDS[node].settings
        fields: dict[str, Any] = {}
        for name, default in defaults.items():
            fields[name] = (model.model_fields[name].annotation, copy.copy(model.model_fields[name]))
            fields[name][1].default = default
        monkeypatch.setattr(KINDS[node], "settings", create_model(model.__name__, __base__=model, **fields))
        assert {name: getattr(parameters_of(node, {}), name) for name in defaults} == defaults


def stated_in(bag: Path) -> dict[str, dict[str, Any]]:
    """Values of parameters that exist today in the provenance of a bag's heights, but for those of the machine."""
    reader = BagReader(bag)
    stated: dict[str, dict[str, Any]] = {}
    topics = [topic.name for topic in reader.topics.values() if topic.type_name == HEIGHT_TYPE]
    for recorded in reader.messages(topics):
        image = reader.decode(recorded.type_name, recorded.cdr)
        for node, values in messages.stages_of(image.provenance.parameters).items():
            known = settings_of(KINDS[node].settings).keys() - OF_MACHINE
            whole = {**exact_then(node), **BEFORE.get(node, {}), **with_new_names(values)}
            stated[node] = {name: value for name, value in whole.items() if name in known}
    return stated


@pytest.mark.usefixtures("other_defaults")
@pytest.mark.parametrize("name", ALL)
def test_the_values_of_a_bag_do_not_depend_on_the_defaults_of_today(name: str) -> None:
    """Of `replay`, `batch` and `live`; parameters that did not exist then have today's default, or do what was done.

    Standard deviations that nobody stated then were 0.
    """
    stated = stated_in(BAGS / name)
    assert stated.keys() >= {"sar_compression"}
    reader = WHOLE.open(BAGS / name)
    chain = chain_of(reader, "phase_history", ())
    processing = processing_of(reader, chain, WHOLE, consumers(chain.makers), {})
    scheme = plan(BAGS / name, {})
    live = Feed.of_bag(BAGS / name).parameters
    for node, recorded in stated.items():
        for found in (processing.values, scheme.values, live):
            assert parameters_of(node, found[node]) == parameters_of(node, recorded)
            assert all(
                getattr(parameters_of(node, found[node]), name) != OTHER[node][name]
                for name in recorded.keys() & OTHER[node]
            )
        sources = processing.sources[node]
        assert {sources[one] for one in recorded} <= {"provenance", "custom data of the bag"}
        assert {sources[one] for one in sources.keys() - recorded.keys()} <= {"default"}
    assert processing.sources["sar_compression"]["rows"] == "custom data of the bag"
    assert processing.sources["sar_compression"]["azimuth_window"] == "provenance"
    assert (processing.warnings, processing.changes, scheme.warnings) == ([], [], [])


def processing(
    reader: BagReader, given: Any = None, chain: ReplayNodes = CHAIN, chosen: Mapping[str, Any] | None = None
) -> ReplayPlan:
    return processing_of(reader, chain, WHOLE, chosen or {}, given or {})


def custom(**values: Any) -> dict[str, str]:
    return {"parameters": json.dumps(values)}


def test_provenance_decides_before_custom_data_and_these_before_events(tmp_path: Path) -> None:
    """Also where custom data say otherwise, for a parameter was set between their being written and the first dwell."""
    event = told("ml_height", range_looks=5, azimuth_looks=5, min_cnr_db=5.0, objective="numerator")
    image = heights(0, ml_height={"range_looks": 3, "layover": False})
    of_custom = custom(ml_height={"range_looks": 4, "azimuth_looks": 4, "layover": False})
    found = processing(
        written(tmp_path / "bag", [event, frame(0), image], of_custom), {"ml_height": {"min_cnr_db": 2.0}}
    )
    expected = {
        "range_looks": (3, "provenance"),
        "layover": (False, "custom data of the bag"),
        "azimuth_looks": (4, "custom data of the bag"),
        "objective": ("numerator", "parameter event"),
        "min_cnr_db": (2.0, "command line"),
    }
    assert {name: (found.values["ml_height"][name], found.sources["ml_height"][name]) for name in expected} == expected
    assert found.values["ml_height"].keys() == {*expected, *exact_then("ml_height")}


def test_odometry_is_exact_in_bags_of_before_it_could_be_stated(tmp_path: Path) -> None:
    """Where provenance, or a simulated flight, states other parameters; all else has the default of today."""
    other, name = {"rows": 8}, "odometry_heading_sigma_rad"
    image, custom_data = heights(0, sar_compression=other), custom(sar_compression=other)
    cases = (
        ([image], {}, 0.0),
        ([heights(0, sar_compression={**other, name: -1.0})], {}, -1.0),
        ([], custom_data, None),
        ([told("sar_compression", rows=8)], {}, None),
        ([], {**custom_data, "preset": "{}"}, 0.0),
        ([], {**custom(sar_compression={**other, name: 0.25}), "preset": "{}"}, 0.25),
        ([], {"preset": "{}"}, None),
    )
    for number, (items, stated, expected) in enumerate(cases):
        found = processing(written(tmp_path / str(number), [*items, frame(0)], stated)).values
        assert found.get("sar_compression", {}).get(name) == expected
        if expected == 0.0:
            assert found["sar_compression"].items() >= exact_then("sar_compression").items()


def test_a_deviation_that_is_stated_anywhere_is_not_one_from_before(tmp_path: Path) -> None:
    """The provenance is of a program that did not know it."""
    said = [frame(0), heights(0, ml_height={"range_looks": 4})]
    found = processing(written(tmp_path / "bag", said, custom(ml_height={"beam_pitch_sigma": 0.002})))
    values, sources = found.values["ml_height"], found.sources["ml_height"]
    assert (values["beam_pitch_sigma"], sources["beam_pitch_sigma"]) == (0.002, "custom data of the bag")
    assert (values["beam_width_sigma"], sources["beam_width_sigma"]) == (0.0, "provenance")


def test_values_that_differ_between_products_are_changes_in_flight(tmp_path: Path) -> None:
    """Those that were defaults then, too."""
    said = [
        m
        for dwell, looks in enumerate((4, 4, 2))
        for m in (frame(dwell), heights(dwell, ml_height={"range_looks": looks}))
    ]
    found = processing(written(tmp_path / "bag", said, custom()))
    assert found.values == {"ml_height": {"range_looks": 4, **exact_then("ml_height")}}
    assert found.changes == [DwellChanges(key(2), {"ml_height": {"range_looks": 2}})]


@pytest.mark.parametrize("flown", [{}, custom(ml_height={"latency_budget_s": 0.5})])
def test_how_dwells_waited_on_the_machine_of_the_flight_is_not_repeated(flown: dict[str, str], tmp_path: Path) -> None:
    """But for what custom data say; nodes would leave out late dwells, or wait to be activated."""
    waiting = {"latency_budget_s": 0.01, "autostart": False}
    assert waiting.keys() == OF_MACHINE
    said = [
        told("ml_height", **waiting),
        *(frame(0), heights(0, ml_height={**waiting, "range_looks": 3})),
        changed("ml_height", latency_budget_s=0.03),
        *(frame(1), heights(1, ml_height={**waiting, "latency_budget_s": 0.03, "range_looks": 3})),
    ]
    found = processing(written(tmp_path / "bag", said, flown))
    waits = {"latency_budget_s": 0.5} if flown else {}
    assert found.values["ml_height"] == {"range_looks": 3, **waits, **exact_then("ml_height")}
    assert (found.changes, found.warnings) == ([], [])
    assert found.sources["ml_height"]["autostart"] == "default"


TERRAIN = {"terrain": "/of/another/machine.tif", "terrain_sigma_m": 0.5}


@pytest.mark.parametrize("source", ["provenance", "parameter event", "custom data of the bag", "command line"])
def test_a_file_that_only_the_provenance_names_is_not_opened(source: str, tmp_path: Path) -> None:
    path = TERRAIN["terrain"]
    said = [frame(0), heights(0, height_adjuster={**TERRAIN, "targets": "", "pose_error": [0.0]})]
    events = [told("height_adjuster", **TERRAIN)] if source == "parameter event" else []
    flown = custom(height_adjuster=TERRAIN) if source.startswith("custom") else {}
    given = {"height_adjuster": {"terrain": path}} if source == "command line" else {}
    chain = ReplayNodes(
        "phase_history", ["ml_height", "height_adjuster"], [*STAGES, "height_adjuster"], 1, ["/phase_history"]
    )
    found = processing(written(tmp_path / "bag", [*events, *said], flown), given, chain)
    values, sources = found.values["height_adjuster"], found.sources["height_adjuster"]
    assert (values["terrain_sigma_m"], values["targets"]) == (0.5, "")
    if source == "provenance":
        assert "terrain" not in values
        assert sources["terrain"] == "default"
        (warning,) = found.warnings
        assert_one_sentence(
            warning, "height_adjuster", repr(path), "provenance", "--param height_adjuster.terrain=FILE"
        )
    else:
        assert (values["terrain"], sources["terrain"], found.warnings) == (path, source, [])


@pytest.mark.parametrize(
    ("flown", "recorded", "applied", "sentences"),
    [
        ("gone.npz", True, HEARD, 0),
        ("gone.npz", False, None, 1),
        (HEARD, True, HEARD, 0),
        ("", True, "", 0),  # of dwell 1 nobody knows, and the order of the bag would have the calibration applied
    ],
)
def test_calibrations_of_the_bag_take_the_place_of_their_file(
    flown: str, recorded: bool, applied: str | None, sentences: int, tmp_path: Path
) -> None:
    image = heights(0, "first" if flown else "", sar_compression={"calibration": flown})
    said = [*([calibration("first")] if recorded else []), frame(0), image, frame(1)]
    found = processing(written(tmp_path / "bag", said, custom()))
    assert found.values.get("sar_compression", {}).get("calibration") == applied
    assert found.plays_calibrations == (applied == HEARD)
    assert len(found.warnings) == sentences
    for warning in found.warnings:
        assert_one_sentence(warning, "'gone.npz'", "--param sar_compression.calibration=FILE")


def test_settings_say_which_of_them_name_files() -> None:
    entries = [one for node in SETTABLE for one in settings_of(KINDS[node].settings).values()]
    assert {one.name for one in entries if one.names_file} == {
        "calibration",
        "file",
        "slope_table",
        "targets",
        "terrain",
    }
    assert all(one.names_file == one.description.startswith("path of") for one in entries)


def test_of_images_no_heights_are_adjusted(tmp_path: Path) -> None:
    """No odometry is played: a node that is asked for is refused, one that worked in flight is left out."""
    info = messages.sensor_to_message(load_preset("small").make_sensor(), messages.to_stamp(0))
    recorded = [info, *(ComplexImage(channel=channel) for channel in range(8)), heights(0)]
    bag = written(tmp_path / "bag", [*recorded, heights(0, estimator="adjusted")])
    with refused(UserError, "adjusted with the odometry", "replay from phase_history"):
        chain_of(bag, IMAGES, ("ml", "adjusted"))
    chain = chain_of(bag, IMAGES, ())
    assert (chain.makers, chain.stages, chain.dwells) == (["ml_height"], ["ml_height", "relief_tracker"], 1)


def test_heights_that_are_not_made_are_not_used(tmp_path: Path) -> None:
    """The tracker takes those of the estimator that is asked for, unless custom data name others."""
    reader = WHOLE.open(BAGS / "version_2")
    chain = chain_of(reader, "phase_history", ["capon"])
    found = processing(reader, chain=chain, chosen=consumers(chain.makers))
    assert found.values["relief_tracker"]["estimator"] == "capon"
    assert found.sources["relief_tracker"]["estimator"] == "chosen by the replay"
    assert found.sources["relief_tracker"]["gate"] == "provenance"
    (warning,) = found.warnings
    assert_one_sentence(warning, "relief_tracker", "'ml' in flight (provenance)", "those of 'capon'")
    assert not processing(reader, {"relief_tracker": {"estimator": "capon"}}, chain, consumers(chain.makers)).warnings
    assert "estimator" not in recorded_parameters(reader, chain.makers)["relief_tracker"]
    assert recorded_parameters(reader)["relief_tracker"]["estimator"] == "ml"
    from_heights = Part(FROM_HEIGHTS)
    chain = chain_of(reader, FROM_HEIGHTS, ())
    found = processing_of(reader, chain, from_heights, consumers(chain.makers), {})
    assert found.values["relief_tracker"]["estimator"] == "ml"
    assert found.values.keys() >= {"relief_tracker"}
    named = written(tmp_path / "bag", [frame(0), heights(0)], custom(relief_tracker={"estimator": "music"}))
    assert processing(named).values["relief_tracker"] == {"estimator": "music"}


@pytest.mark.parametrize(
    ("events", "image", "flown", "subject"),
    [
        ({}, {"range_looks": 0}, {}, "the provenance of bag {}"),
        ({"range_looks": 0}, {}, {}, "a parameter event of bag {}"),
        ({}, {}, custom(ml_height={"range_looks": 0}), "the custom data of bag {}"),
    ],
)
def test_what_is_not_allowed_today_is_refused_unless_it_is_replaced(
    events: dict[str, Any], image: dict[str, Any], flown: dict[str, str], subject: str, tmp_path: Path
) -> None:
    said = [told("ml_height", azimuth_looks=3, **events), frame(0), heights(0, ml_height={"layover": True, **image})]
    reader = written(tmp_path / "bag", said, flown)
    with pytest.raises(UserError) as error:
        processing(reader)
    stated = f"{subject.format(reader.path)} states the value, and --param ml_height.range_looks=VALUE replaces it"
    assert_one_sentence(str(error.value), "Node ml_height: Parameter range_looks is 0; it must be", stated)
    assert processing(reader, {"ml_height": {"range_looks": 5}}).values["ml_height"]["range_looks"] == 5
    for given in ({"ml_height": {"range_looks": -1}}, {"ml_height": {"looks": 1}}):  # which the bag does not state
        with pytest.raises(UserError) as error:
            processing(reader, given)
        assert "replaces it" not in str(error.value)


def test_values_of_nodes_that_are_not_at_work_are_not_looked_at(tmp_path: Path) -> None:
    """They may be refused today, and could not be replaced where their node does not work."""
    stages = {"sar_compression": {"rows": -1}, "capon_height": {"loading": -1.0}, "ml_height": {"range_looks": 3}}
    reader = written(tmp_path / "bag", [frame(0), heights(0, **stages)])
    chain = ReplayNodes("slc", ["ml_height"], ["ml_height", "relief_tracker"], 1, ["/phase_history"])
    found = processing(reader, chain=chain)
    assert found.values == {"ml_height": {"range_looks": 3, **exact_then("ml_height")}}
    with pytest.raises(UserError, match=r"sar_compression\.rows=VALUE"):
        processing(reader)


def test_values_that_are_not_allowed_together_are_refused_with_one_that_can_be_replaced(tmp_path: Path) -> None:
    reader = written(
        tmp_path / "bag", [frame(0), heights(0, sum_difference_height={"range_looks": 1, "azimuth_looks": 1})]
    )
    chain = ReplayNodes("phase_history", ["sum_difference_height"], ["sum_difference_height"], 1, ["/phase_history"])
    with pytest.raises(UserError, match=r"both 1.*--param sum_difference_height\.range_looks=VALUE"):
        processing(reader, chain=chain)
    assert processing(reader, {"sum_difference_height": {"range_looks": 4}}, chain).values


def test_a_change_that_is_not_allowed_today_is_refused_with_its_dwell(tmp_path: Path) -> None:
    said = [
        m
        for dwell, looks in enumerate((4, 0))
        for m in (frame(dwell), heights(dwell, ml_height={"range_looks": looks}))
    ]
    reader = written(tmp_path / "bag", said, custom())
    with pytest.raises(UserError) as error:
        processing(reader)
    stated = f"the provenance of bag {reader.path} states the value from dwell 1 on, and --param ml_height.range_looks="
    assert_one_sentence(str(error.value), "Parameter range_looks is 0", stated)
    assert processing(reader, {"ml_height": {"range_looks": 5}}).changes == []


def test_parameters_of_a_second_node_of_a_kind_are_its_own(tmp_path: Path) -> None:
    stages = {"ml_height": {"range_looks": 3, "of_yesterday": 1}, "coarse": {"range_looks": 8, "layover": False}}
    found = processing(written(tmp_path / "bag", [frame(0), heights(0, **stages)], custom()))
    assert found.values == {"ml_height": {"range_looks": 3, **exact_then("ml_height")}}
    gone, unknown = found.warnings
    assert_one_sentence(gone, "ml_height", "of_yesterday", "provenance")
    assert_one_sentence(unknown, "coarse", "provenance")


def test_values_are_those_of_the_products_in_a_namespace(tmp_path: Path) -> None:
    """Nodes of the same name in another one have values of their own."""
    looks = {"lidar": 3, "radar": 8}
    said = {f"/{name}": [frame(0), heights(0, ml_height={"range_looks": value})] for name, value in looks.items()}
    bag = written_apart(tmp_path / "bag", said, custom())
    for name, value in looks.items():
        assert processing(Part(namespace=name).open(bag.path)).values == {
            "ml_height": {"range_looks": value, **exact_then("ml_height")}
        }


@pytest.mark.parametrize(("latitude", "expected"), [(0.0, 48.1), (47.0, 47.0)])
def test_a_map_is_placed_by_its_topic_unless_the_mapper_had_a_place(
    latitude: float, expected: float, tmp_path: Path
) -> None:
    origin = messages.origin_to_message(
        Origin(math.radians(48.1), math.radians(11.3), 560.0), messages.to_stamp(5), "map"
    )
    mapper = told("relief_mapper", origin_latitude_deg=latitude, origin_longitude_deg=0.0, origin_height_m=0.0)
    values = recorded_parameters(written(tmp_path / "bag", [origin, mapper, frame(0)]))
    assert values["relief_mapper"]["origin_latitude_deg"] == pytest.approx(expected)
    assert values["ground_mapper"]["origin_latitude_deg"] == pytest.approx(48.1)


@pytest.mark.parametrize("estimator", [["ml"], 1, "none"])
def test_what_is_no_estimator_is_refused_or_not_used(estimator: Any, tmp_path: Path) -> None:
    """What a node of another program states; a text may be an estimator of another version."""
    reader = written(tmp_path / "bag", [frame(0), heights(0, relief_tracker={"estimator": estimator})])
    if isinstance(estimator, str):
        assert "estimator" not in processing(reader).values.get("relief_tracker", {})
        return
    with pytest.raises(UserError, match=r"relief_tracker: .*--param relief_tracker\.estimator=VALUE"):
        processing(reader)


def test_every_value_has_a_source(tmp_path: Path) -> None:
    made = {"range_looks": 4, "azimuth_looks": 1, "min_cnr_db": 17.0}
    reader = written(
        tmp_path / "bag",
        [frame(0), heights(0, ml_height=made)],
        custom(ml_height={"range_looks": 4, "azimuth_looks": 4}),
    )
    chosen = {"relief_tracker": {"estimator": "capon"}}
    found = processing(reader, {"ml_height": {"objective": "numerator"}}, chosen=chosen)
    assert found.values == {
        "ml_height": {**made, "objective": "numerator", **exact_then("ml_height")},
        "relief_tracker": {"estimator": "capon"},
    }
    sources = found.sources["ml_height"]
    assert sources["range_looks"] == "custom data of the bag"
    assert sources["azimuth_looks"] == "provenance"  # somebody set it before the first dwell
    assert sources["min_cnr_db"] == "provenance"  # may have been the default of that time
    assert sources["layover"] == "default"  # which nothing states
    assert sources["objective"] == "command line"
    assert found.sources["relief_tracker"]["estimator"] == "chosen by the replay"
    assert set(found.sources["sar_compression"].values()) == {"default"}
    assert (found.changes, found.warnings) == ([], [])


def test_numbers_without_a_point_are_numbers(tmp_path: Path) -> None:
    """JSON writes 1e-05, which YAML takes for a text."""
    stated = custom(sar_compression={"odometry_delay_sigma_s": 1e-5})
    found = processing(written(tmp_path / "bag", [frame(0)], stated))
    assert found.values["sar_compression"] == {"odometry_delay_sigma_s": 1e-5}


def test_a_simulated_sensor_that_states_no_air_flew_in_vacuum(tmp_path: Path) -> None:
    """As bags do that were recorded before the default was another one; what is stated counts."""
    simulated = {"preset": "{}"}
    assert processing(written(tmp_path / "a", [frame(0)], simulated)).values["sar_compression"] == {"air": "none"}
    stated = simulated | custom(sar_compression={"air": "standard"})
    found = processing(written(tmp_path / "b", [frame(0)], stated)).values["sar_compression"]
    assert found == {"air": "standard", **exact_then("sar_compression")}
    assert "sar_compression" not in processing(written(tmp_path / "c", [frame(0)], custom())).values


def test_changes_are_scheduled_but_for_what_the_user_sets_and_for_nodes_that_are_not_there(
    tmp_path: Path,
) -> None:
    said = [
        told("ml_height", range_looks=3),
        frame(0),
        changed("ml_height", range_looks=2, azimuth_looks=2),
        changed("monopulse", range_looks=2),
        frame(1),
    ]
    reader = written(tmp_path / "bag", said)
    assert processing(reader).changes == [DwellChanges(key(1), {"ml_height": {"range_looks": 2, "azimuth_looks": 2}})]
    given = processing(reader, {"ml_height": {"range_looks": 5}})
    assert given.changes == [DwellChanges(key(1), {"ml_height": {"azimuth_looks": 2}})]
    assert given.values["ml_height"]["range_looks"] == 5


def test_what_cannot_be_done_again_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    stage = {"sar_compression": {"calibration": "topic"}, "ml_height": {"of_yesterday": 1}}
    said = [
        told("sar_compression", map_frame="map"),
        *(frame(0), heights(0, "lost", **stage)),
        told("sar_compression", map_frame="world"),
        *(frame(1), heights(1, "lost", **stage)),
        frame(2),
    ]
    found = processing(written(tmp_path / "bag", said))
    gone, restarted, lost = found.warnings
    assert_one_sentence(gone, "ml_height", "of_yesterday", "provenance")
    assert_one_sentence(restarted, "sar_compression", "map_frame='world'", "dwell 1")
    assert_one_sentence(lost, "'lost'", "dwell 0", "/calibration")
    assert [text.endswith(end) for text, end in zip(caplog.messages, found.warnings, strict=True)] == [True] * 3
    assert found.changes == []


@pytest.mark.parametrize(
    ("flown", "given", "applied", "played"),
    [
        ("topic", None, "topic", True),
        ("gone.npz", None, "topic", True),  # the bag has what the file had
        ("gone.npz", "mine.npz", "mine.npz", False),
        ("topic", "", "", False),
    ],
)
def test_the_calibration_of_the_bag_is_applied_unless_the_user_has_another(
    flown: str, given: str | None, applied: str, played: bool, tmp_path: Path
) -> None:
    image = heights(0, "first", sar_compression={"calibration": flown})
    reader = written(tmp_path / "bag", [calibration("first"), frame(0), image])
    found = processing(reader, None if given is None else {"sar_compression": {"calibration": given}})
    assert found.values["sar_compression"]["calibration"] == applied
    assert found.plays_calibrations is played
    assert found.changes == ([DwellChanges(key(0), {}, ("first",))] if played else [])


def test_calibrations_that_nobody_applied_in_flight_are_applied_if_the_user_wants_it(tmp_path: Path) -> None:
    """Each from the dwell on before which it came; they are left out otherwise."""
    said = [calibration("one"), frame(0), heights(0), calibration("two"), frame(1), heights(1), frame(2), heights(2)]
    reader = written(tmp_path / "bag", said)
    assert processing(reader).changes == []
    wanted = processing(reader, {"sar_compression": {"calibration": "topic"}})
    assert wanted.changes == [DwellChanges(key(0), {}, ("one",)), DwellChanges(key(1), {}, ("two",))]
