"""What a stripmap sensor lights up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, make_beams

from sal_height.beams import PATTERNS
from sal_height.sensor import lit_angle


@pytest.mark.parametrize("name", sorted(PATTERNS))
@pytest.mark.parametrize("rotation", [0.0, 0.4])
def test_the_main_lobes_of_all_beams_are_lit(name: str, rotation: float) -> None:
    """Eight detectors half a beamwidth apart: the last one looks 1.75 sin(psi) beamwidths ahead."""
    beams = replace(make_beams(name, 8), rotation=rotation)
    expected = PATTERNS[name].main_lobe + 1.75 * np.sin(rotation)
    assert lit_angle(beams) / BEAMWIDTH == pytest.approx(expected, rel=1e-9)


def test_the_widest_main_lobe_counts() -> None:
    beams = replace(make_beams(count=2), patterns=(PATTERNS["sinc"], PATTERNS["jinc"]))
    assert lit_angle(beams) / BEAMWIDTH == pytest.approx(PATTERNS["jinc"].main_lobe, rel=1e-9)
