"""Results as labelled arrays and as pictures, for a session in a notebook."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from helpers import refused

from sal_height.elevation import Validity
from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging import Slc
from sal_height.relief import GroundKind, HeightField, Relief, Surface

GRID = Grid(np.array([100.0, 200.0, 3.0]), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 2.0, 0.5, 3, 4)


def made_field() -> HeightField:
    height = np.arange(12.0).reshape(3, 4)
    height[0, 0] = np.nan
    positions = GRID.pixels()
    positions[0, 0] = np.nan
    surface = Surface.at(positions, height, np.full((3, 4), 0.25), np.full((3, 4), 20.0))
    validity = np.full((3, 4), Validity.OK, np.uint8)
    validity[0, 0] = Validity.NO_SIGNAL
    return HeightField(GRID, validity, (surface,))


def made_slc() -> Slc:
    images = np.ones((2, 3, 4), np.complex64)
    images[1] = 10j
    aperture = ApertureState(np.zeros(3), np.array([50.0, 0, 0]), np.eye(3), 0.1, np.zeros((6, 6)))
    return Slc(images, GRID, aperture, np.array([1.0, 4.0]), np.zeros(2))


def made_map() -> Relief:
    height = np.array([[1.0, np.nan], [2.0, 3.0], [4.0, 5.0]], np.float32)
    kind = np.full(height.shape, GroundKind.INTERPOLATED, np.uint8)
    return Relief(10.0, -20.0, 2.0, height, 0.1 * height, np.ones_like(height), np.ones(height.shape, np.uint32), kind)


@pytest.fixture
def pictures() -> Iterator[None]:
    """Figures of Matplotlib without a display, closed at the end."""
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    yield
    plt.close("all")


def test_heights_have_names_units_and_reasons() -> None:
    found = made_field().to_xarray()
    assert found["height"].dims == ("surface", "row", "col")
    assert dict(found.sizes) == {"surface": 1, "row": 3, "col": 4}
    assert {name: found[name].attrs["units"] for name in ("height", "sigma", "cnr_db", "x", "y")} == {
        **dict.fromkeys(("height", "sigma", "x", "y"), "m"),
        "cnr_db": "dB",
    }
    assert found["validity"].attrs["flag_meanings"].split() == [one.name.lower() for one in Validity]
    assert np.isnan(found["height"].values[0, 0, 0])
    assert found["x"].values[0, 1, 2] == pytest.approx(101.0, abs=1e-3)  # along the sphere, not the plane
    assert found["height"].values[0, 1, 2] == pytest.approx(3.0, abs=0.01)


def test_images_have_positions_and_noise() -> None:
    found = made_slc().to_xarray()
    assert found.dims == ("channel", "row", "col")
    assert found.dtype == np.complex64
    assert (found["x"].values[2, 3], found["y"].values[2, 3], found["z"].values[0, 0]) == (101.5, 204.0, 3.0)
    assert found["noise_power"].values.tolist() == [1.0, 4.0]


def test_a_map_has_distances_of_the_centres_of_its_cells() -> None:
    found = made_map().to_xarray()
    assert found["x"].values.tolist() == [10.0, 12.0]
    assert found["y"].values.tolist() == [-20.0, -18.0, -16.0]
    assert float(found["height"].sel(x=12.0, y=-16.0)) == 5.0
    assert found["kind"].attrs["flag_meanings"] == "measured interpolated shadow unseen"


@pytest.mark.parametrize("make", [made_field, made_slc, made_map])
def test_without_xarray_one_sentence_says_what_to_install(make: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with refused(UserError, "needs xarray", "pip install 'sal_height[formats]'"):
        make().to_xarray()  # type: ignore[operator]


@pytest.mark.usefixtures("pictures")
def test_pictures_have_axes_in_metres_and_a_bar_of_colours() -> None:
    import matplotlib.pyplot as plt

    for drawn, unit in ((made_field(), "(m)"), (made_slc(), "(dB over its noise)"), (made_map(), "(m)")):
        axes = drawn.plot()
        assert "(m)" in axes.get_xlabel()
        assert "(m)" in axes.get_ylabel()
        assert unit in axes.figure.axes[1].get_ylabel()
    extent = axes.images[0].get_extent()
    assert tuple(extent) == (9.0, 13.0, -21.0, -15.0)  # edges of cells whose centres are 10 to 12 and -20 to -16
    _, given = plt.subplots()
    assert made_slc().plot(channel=1, axes=given) is given
    assert given.images[0].get_array().max() == pytest.approx(10 * np.log10(100 / 4))
    unknown = replace(made_slc(), noise_power=np.zeros(2)).plot(channel=1)
    assert unknown.images[0].get_array().max() == pytest.approx(20.0)
    assert unknown.figure.axes[1].get_ylabel() == "power of channel 1 (dB)"
