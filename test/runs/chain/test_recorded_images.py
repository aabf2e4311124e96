"""Images of a bag: those recorded in it, or those that its phase history gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sal_height.runs.chain.recorded_images import recorded_slc
from sal_height.runs.products.tomogram import tomogram
from sal_height.runs.responses.irf import irf

LOOKS = 12, 12


def test_images_that_are_not_recorded_are_made_as_in_flight(recorded: Path, with_images: Path) -> None:
    """Value for value, with all that their messages say."""
    made, expected = list(recorded_slc(recorded / "bag")), list(recorded_slc(with_images))
    assert len(made) == len(expected) == 16
    for (topic, message, pixels, grid, sensor), (_, told, right, _, _) in zip(made, expected, strict=True):
        assert topic == "/slc"
        assert np.array_equal(pixels, right)
        assert (message.dwell, message.channel, message.noise_power) == (told.dwell, told.channel, told.noise_power)
        assert (pixels.shape, message.provenance.config_hash) == (grid.shape, sensor.config_hash)
        assert repr(message.provenance.parameters) == repr(told.provenance.parameters)


def test_several_jobs_make_the_same_images_in_the_same_order(recorded: Path) -> None:
    one, two = ([*recorded_slc(recorded / "bag", jobs)] for jobs in (1, 2))
    assert len(one) == len(two) == 16
    for (topic, message, pixels, *_), (other_topic, other, others, *_) in zip(one, two, strict=True):
        assert (topic, repr(message), pixels.tobytes()) == (other_topic, repr(other), others.tobytes())


@pytest.mark.thorough
def test_they_can_be_measured_and_cut(recorded: Path, with_images: Path, tmp_path: Path) -> None:
    bags = {"made": recorded / "bag", "recorded": with_images}
    entries = {name: irf([bag], tmp_path / name, jobs=2) for name, bag in bags.items()}
    without_names = [[{**one, "image": ""} for one in found] for found in entries.values()]
    assert without_names[0] == without_names[1]
    told = [tomogram(bag, tmp_path / f"cut_{name}", LOOKS, None, jobs=2) for name, bag in bags.items()]
    assert told[0] == told[1]
