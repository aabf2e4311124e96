"""Provenance: what is known of the images stays known of all that is made of them."""

from __future__ import annotations

import json

from sal_height_msgs.msg import Provenance

from sal_height import __version__, messages
from sal_height.messages.provenance import recorded
from sal_height.settings import Settings


class Looks(Settings):
    """Parameters of some stage."""

    range_looks: int = 3


def test_a_product_keeps_what_is_known_of_the_images_it_is_made_of() -> None:
    images = Provenance(
        code_version="0",
        config_hash="f00",
        calibration_id="ca1",
        parameters='{"sar_compression": {"autofocus": true}}',
        autofocus_phase=[0.5, -0.25],
    )
    heights = messages.derived(images, "ml_height", Looks())
    assert (heights.code_version, heights.config_hash, heights.calibration_id) == (__version__, "f00", "ca1")
    assert list(heights.autofocus_phase) == [0.5, -0.25]
    assert json.loads(heights.parameters) == {"sar_compression": {"autofocus": True}, "ml_height": {"range_looks": 3}}


def test_words_of_another_program_are_kept_beside_ours() -> None:
    made = messages.as_json("monopulse", Looks(range_looks=4), "not JSON")
    assert json.loads(made) == {"before": "not JSON", "monopulse": {"range_looks": 4}}
    assert recorded(made, "monopulse", "range_looks") == 4
    assert recorded(made, "monopulse", "azimuth_looks") is None
