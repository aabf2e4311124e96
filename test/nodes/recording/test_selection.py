"""Which topics a recorder takes, of those that there are."""

from __future__ import annotations

import pytest

from sal_height.errors import UserError
from sal_height.nodes.recording.recorder_parameters import Selection

ODOMETRY, HEIGHT = ["nav_msgs/msg/Odometry"], ["sal_height_msgs/msg/HeightImage"]
TOPICS = {
    "/platform/odometry": ODOMETRY,
    "/ml/height": HEIGHT,
    "/ml/heights": HEIGHT,
    "/monopulse/height": HEIGHT,
    "/rosout": ["rcl_interfaces/msg/Log"],
    "/parameter_events": ["rcl_interfaces/msg/ParameterEvent"],
    "/progress": ["diagnostic_msgs/msg/DiagnosticArray"],
}


def chosen(**asked: list[str]) -> list[str]:
    selection = Selection(**asked)
    return [name for name, types in TOPICS.items() if selection.wants(name, types)]


def test_nothing_asked_for_is_all_but_those_of_ros() -> None:
    assert chosen() == ["/platform/odometry", "/ml/height", "/ml/heights", "/monopulse/height"]
    assert chosen(excluded=["/ml/.*"]) == ["/platform/odometry", "/monopulse/height"]


def test_topics_are_asked_for_by_name_pattern_or_type() -> None:
    assert chosen(names=["/rosout", "/nowhere"]) == ["/rosout"]
    assert chosen(patterns=["/ml/height"]) == ["/ml/height"]  # the whole name
    assert chosen(patterns=["/(ml|monopulse)/height"], types=ODOMETRY) == [
        "/platform/odometry",
        "/ml/height",
        "/monopulse/height",
    ]
    assert chosen(patterns=["/p.*"]) == ["/platform/odometry", "/parameter_events", "/progress"]


def test_what_is_asked_for_by_name_is_taken_though_a_pattern_excludes_it() -> None:
    assert chosen(names=["/ml/height"], types=HEIGHT, excluded=["/ml/.*"]) == ["/ml/height", "/monopulse/height"]


@pytest.mark.parametrize(
    ("asked", "is_open"),
    [
        ({}, True),
        ({"names": ["/a"]}, False),
        ({"names": ["/a"], "types": ODOMETRY}, True),
        ({"patterns": ["/a"]}, True),
    ],
)
def test_the_search_ends_where_only_names_are_asked_for(asked: dict[str, list[str]], is_open: bool) -> None:
    assert Selection(**asked).is_open == is_open


@pytest.mark.parametrize("parameter", ["patterns", "excluded"])
def test_what_is_no_regular_expression_is_refused(parameter: str) -> None:
    with pytest.raises(UserError, match=rf"Parameter {parameter} has '\*/height', which is no regular expression"):
        Selection(**{parameter: ["*/height"]})
