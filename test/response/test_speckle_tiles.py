"""Pure speckle is found with the stated significance; what is not pure is left out, and counted."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import assert_one_sentence, circular

from sal_height.errors import NotDetermined, UserError
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, Target, make_tape
from sal_height.response.speckle_tiles import REASONS, find_pure_speckle, sum_of_powers

TAPES = {
    "wide response": {"range_fault": RangeFault(), "azimuth_fault": AzimuthFault()},
    "swing": {"range_fault": RangeFault(), "azimuth_fault": AzimuthFault(swing=0.1)},
    "noise": {"range_fault": RangeFault(), "azimuth_fault": AzimuthFault(), "noise": 0.6},
}


@pytest.mark.parametrize("name", TAPES)
@pytest.mark.parametrize("tile", [(32, 32), (64, 12)])
def test_each_test_loses_its_significance_of_pure_speckle(name: str, tile: tuple[int, int]) -> None:
    """5 % of 2048 and more tiles: standard error 0.5 %."""
    rng, lost, tiles = np.random.default_rng(31), {"moment": 0, "texture": 0}, 0
    for _ in range(2):
        counts = find_pure_speckle(make_tape((1024, 1024), rng, **TAPES[name]), tile, 0.05).counts()
        tiles += sum(counts.values())
        lost = {reason: lost[reason] + counts[reason] for reason in lost}
    assert 0.030 < lost["moment"] / tiles < 0.068
    assert 0.020 < lost["texture"] / tiles < 0.068


def test_moment_has_the_variance_of_its_independent_pixels() -> None:
    """4 sum |rho|^4 / pixels; of 1024 tiles the variance is known to 5 %. The contrast is Rayleigh's."""
    image = make_tape((2048, 512), np.random.default_rng(5), **TAPES["wide response"])
    found = find_pure_speckle(image, (32, 32))
    range_rho = np.fft.ifft(np.fft.ifftshift(np.abs(RangeFault().response(2048)) ** 2))
    azimuth_rho = np.fft.ifft(np.fft.ifftshift(np.abs(AzimuthFault().response(512)) ** 2))
    lags = np.arange(-16, 17)
    triangle = 1 - np.abs(lags) / 32
    down = np.sum(triangle * np.abs(range_rho[lags] / range_rho[0]) ** 4)
    across = np.sum(triangle * np.abs(azimuth_rho[lags] / azimuth_rho[0]) ** 4)
    assert sum_of_powers(found.correlation, (32, 32), 4) == pytest.approx(down * across, rel=0.05)
    assert np.var(found.moment) == pytest.approx(4 * down * across / 32**2, rel=0.2)
    assert np.mean(found.texture) == pytest.approx(1, abs=3.5 * np.std(found.texture) / np.sqrt(1024))
    amplitude = np.abs(image)
    assert amplitude.std() / amplitude.mean() == pytest.approx(np.sqrt(4 / np.pi - 1), abs=0.005)


def test_what_is_not_pure_is_counted_by_its_reason() -> None:
    """Each in a tile of its own, of 8 x 8; the others are pure but for the significance."""
    targets = (Target(32, 32, 30), Target(100, 40, 25))
    image = make_tape((512, 512), np.random.default_rng(6), targets, RangeFault(), AzimuthFault())
    image[128 + 5, 3] = np.nan
    image[128 + 5, 64 + 3] = np.inf + 1j
    image[256 : 256 + 64, :64][10:20] = 0
    image[256 : 256 + 64, 64:128].imag = 0
    block = image[256 : 256 + 64, 128:192]
    block.real, block.imag = np.clip(block.real, -1, 1), np.clip(block.imag, -1, 1)
    image[384:448, 64:128][::2] *= 2
    image[384:448, 128:192] *= 1 + 0.3 * np.sin(2 * np.pi * np.arange(64) / 64)
    found = find_pure_speckle(image)
    counts = found.counts()
    assert found.verdict[0, 0] == REASONS.index("moment")
    assert found.verdict[1, 0] == REASONS.index("moment")
    assert (counts["not finite"], counts["zero"], counts["real"], counts["clipped"]) == (2, 1, 1, 1)
    assert not found.pure[6, 1]
    assert not found.pure[6, 2]
    assert found.pure.sum() >= 64 - 9 - 2
    assert np.isfinite(found.correlation).all()
    assert sum(counts.values()) == 64


def test_slow_texture_is_seen_where_the_moment_does_not_tell() -> None:
    """A swing of the amplitude by 15 % along a tile adds 0.09 to the moment, 1.6 of its standard errors."""
    image = make_tape((512, 512), np.random.default_rng(7), **TAPES["wide response"])
    plain = find_pure_speckle(image, significance=0.01).counts()
    image *= 1 + 0.15 * np.sin(2 * np.pi * np.arange(512) / 64)
    textured = find_pure_speckle(image, significance=0.01).counts()
    assert plain["texture"] <= 3
    assert textured["texture"] > 0.35 * 64
    assert textured["moment"] < 0.25 * 64


def test_brightness_from_tile_to_tile_does_not_matter() -> None:
    image = make_tape((512, 512), np.random.default_rng(8), **TAPES["wide response"])
    gain = np.repeat(np.geomspace(1e-3, 1e3, 8), 64).astype(np.float32)
    expected, found = find_pure_speckle(image), find_pure_speckle(image * gain)
    np.testing.assert_array_equal(found.verdict, expected.verdict)
    np.testing.assert_allclose(found.intensity, expected.intensity * gain[::64] ** 2, rtol=1e-5)


def test_receiver_noise_is_no_speckle() -> None:
    """The response of a flat spectrum would be 1 at all frequencies. One tile of 1000 of noise is taken for speckle."""
    rng = np.random.default_rng(11)
    noise = circular(rng, (2048, 2048)).astype(np.complex64)
    water = find_pure_speckle(make_tape((256, 256), rng, **TAPES["wide response"]))
    assert water.counts()["white"] == 0
    with pytest.raises(NotDetermined) as error:
        find_pure_speckle(noise[:256, :256])
    assert_one_sentence(str(error.value), "16 white", "receiver noise")
    counts = find_pure_speckle(noise, (32, 32), 0.05).counts()
    assert counts["pure"] / (counts["pure"] + counts["white"]) == pytest.approx(0.05, abs=0.011)  # 3 standard errors


def test_noise_beside_land_is_left_out() -> None:
    """Half of the image is land, half is calm water, which returns nothing."""
    rng = np.random.default_rng(12)
    land = make_tape((256, 256), rng, **TAPES["wide response"])
    image = np.hstack([land, circular(rng, (256, 256)).astype(np.complex64)])
    found = find_pure_speckle(image)
    assert found.pure[:, :4].sum() >= 15
    assert found.counts()["white"] >= 15


def test_small_images_have_small_tiles() -> None:
    white = circular(np.random.default_rng(9), (185, 12))
    found = find_pure_speckle((white[1:] + white[:-1]).astype(np.complex64))
    assert found.tile == (64, 12)
    assert found.pure.tolist() == [[True], [True]]


def test_an_image_of_targets_has_no_pure_speckle() -> None:
    targets = tuple(Target(32 + 64 * i, 32 + 64 * j, 40) for i in range(2) for j in range(2))
    image = make_tape((128, 128), np.random.default_rng(10), targets, RangeFault(), AzimuthFault())
    with pytest.raises(NotDetermined) as error:
        find_pure_speckle(image)
    assert_one_sentence(str(error.value), "4 tiles", "4 moment", "needed")
    with pytest.raises(NotDetermined, match="4 not finite"):
        find_pure_speckle(np.full((128, 128), np.nan, dtype=np.complex64))


def test_images_that_are_none_are_refused() -> None:
    for wrong in (np.ones((64, 64), np.float32), np.ones((2, 64, 64), np.complex64)):
        with pytest.raises(UserError) as error:
            find_pure_speckle(wrong)
        assert_one_sentence(str(error.value), "complex")
    with pytest.raises(NotDetermined) as few:
        find_pure_speckle(np.ones((4, 200), np.complex64))
    assert_one_sentence(str(few.value), "4 x 200", "8 pixels")
