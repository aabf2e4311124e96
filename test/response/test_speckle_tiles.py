"""Pure speckle is found with the stated significance; what is not pure is left out, and counted."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import assert_one_sentence, circular, refused

from sal_height.errors import NotDetermined, UserError
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, TapeTarget, make_tape
from sal_height.numeric.windows import window
from sal_height.response.speckle_tiles import REASONS, SpeckleSettings, find_pure_speckle, sum_of_powers

TAPES = {
    "wide response": {"range_fault": RangeFault(), "azimuth_fault": AzimuthFault()},
    "swing": {"range_fault": RangeFault(), "azimuth_fault": AzimuthFault(swing=0.1)},
    "noise": {"range_fault": RangeFault(), "azimuth_fault": AzimuthFault(), "noise": 0.6},
}


def strict(significance: float) -> SpeckleSettings:
    return SpeckleSettings(speckle_significance=significance)


@pytest.mark.parametrize("name", TAPES)
@pytest.mark.parametrize("tile", [(32, 32), (64, 12)])
def test_each_test_loses_its_significance_of_pure_speckle(name: str, tile: tuple[int, int]) -> None:
    """5 % of 2048 and more tiles: standard error 0.5 %."""
    rng, lost, tiles = np.random.default_rng(31), {"moment": 0, "texture": 0}, 0
    for _ in range(2):
        counts = find_pure_speckle(make_tape((1024, 1024), rng, **TAPES[name]), tile, strict(0.05)).counts()
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
    power = np.abs(image.reshape(64, 32, 16, 32)) ** 2
    moment = np.mean(power**2, axis=(1, 3)) / np.mean(power, axis=(1, 3)) ** 2
    assert np.var(moment) == pytest.approx(4 * down * across / 32**2, rel=0.2)
    blocks = power.reshape(64, 8, 4, 16, 8, 4).mean(axis=(2, 5)) / np.mean(power, axis=(1, 3))[:, None, :, None]
    of_block, of_tile = (sum_of_powers(found.correlation, (side, side), 2) / side**2 for side in (4, 32))
    texture = np.var(blocks, axis=(1, 3)) / (of_block - of_tile)
    assert np.mean(texture) == pytest.approx(1, abs=3.5 * np.std(texture) / np.sqrt(1024))
    amplitude = np.abs(image)
    assert amplitude.std() / amplitude.mean() == pytest.approx(np.sqrt(4 / np.pi - 1), abs=0.005)


def test_what_is_not_pure_is_counted_by_its_reason() -> None:
    """Each in a tile of its own, of 8 x 8; the others are pure but for the significance."""
    targets = (TapeTarget(32, 32, 30), TapeTarget(100, 40, 25))
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
    plain = find_pure_speckle(image, settings=strict(0.01)).counts()
    image *= 1 + 0.15 * np.sin(2 * np.pi * np.arange(512) / 64)
    textured = find_pure_speckle(image, settings=strict(0.01)).counts()
    assert plain["texture"] <= 3
    assert textured["texture"] > 0.35 * 64
    assert textured["moment"] < 0.25 * 64


def test_brightness_from_tile_to_tile_does_not_matter() -> None:
    image = make_tape((512, 512), np.random.default_rng(8), **TAPES["wide response"])
    gain = np.repeat(np.geomspace(1e-3, 1e3, 8), 64).astype(np.float32)
    expected, found = find_pure_speckle(image), find_pure_speckle(image * gain)
    np.testing.assert_array_equal(found.verdict, expected.verdict)
    np.testing.assert_allclose(found.intensity, expected.intensity * gain[::64] ** 2, rtol=1e-5)


def behind_window(rng: np.random.Generator, shape: tuple[int, int], name: str) -> np.ndarray:
    """Receiver noise of power 1 that has passed a window over four fifths of the range frequencies."""
    weights = np.zeros(shape[0])
    weights[: shape[0] * 4 // 5] = window(name, shape[0] * 4 // 5)
    noise = np.fft.ifft(np.fft.fft(circular(rng, shape), axis=0) * weights[:, None], axis=0)
    return (noise / np.sqrt(np.mean(weights**2))).astype(np.complex64)


@pytest.mark.parametrize("name", ["white", "rectangular", "taylor"])
def test_receiver_noise_is_no_speckle(name: str) -> None:
    """Its response would be that of the window. Of 1000 images 3.0 to 4.9 % have such a tile at a nominal 5 %.

    Of 60 the share has a standard error of 2.8 %.
    """
    rng, fooled = np.random.default_rng(11), 0
    for _ in range(60):
        noise = (
            circular(rng, (256, 128)).astype(np.complex64) if name == "white" else behind_window(rng, (256, 128), name)
        )
        try:
            fooled += find_pure_speckle(noise, (64, 64), strict(0.05)).pure.any()
        except NotDetermined as error:
            assert_one_sentence(str(error), "8 like noise", "receiver noise", "needed")
    assert fooled / 60 < 0.05 + 3 * 0.028


def test_noise_of_known_power_is_told_from_speckle_of_any_response() -> None:
    """Speckle that fills all azimuth frequencies is white there, and 10 dB over the noise."""
    rng = np.random.default_rng(13)
    flat = behind_window(rng, (256, 256), "taylor")
    with pytest.raises(NotDetermined):
        find_pure_speckle(flat)
    assert find_pure_speckle(flat, noise_power=0.1).counts()["like noise"] == 0
    with pytest.raises(NotDetermined, match="16 like noise"):
        find_pure_speckle(flat, noise_power=1.0)
    water = make_tape((256, 256), rng, **TAPES["noise"])
    assert find_pure_speckle(water, noise_power=0.6**2).counts()["like noise"] == 0
    darker = SpeckleSettings(speckle_over_noise_db=9.0)
    with pytest.raises(NotDetermined, match="well above the noise"):
        find_pure_speckle(water, settings=darker, noise_power=0.6**2)


def test_speckle_is_not_taken_for_noise() -> None:
    """Not one of 1536 tiles with a response that fills 90 % of the azimuth frequencies evenly, or with equal noise.

    At 93 %, where neighbours correlate by 0.075, 4 % of the tiles are lost.
    """
    rng, tiles = np.random.default_rng(14), 0
    band = np.abs(np.fft.fftfreq(1024)) < 0.9 / 2
    for _ in range(3):
        even = np.fft.ifft(np.fft.fft(circular(rng, (1024, 1024)), axis=1) * band, axis=1).astype(np.complex64)
        noisy = make_tape((1024, 1024), rng, range_fault=RangeFault(), azimuth_fault=AzimuthFault(), noise=1.0)
        for image in (even, noisy):
            counts = find_pure_speckle(image).counts()
            tiles += sum(counts.values())
            assert counts["like noise"] == 0
    assert tiles == 6 * 256


def test_noise_beside_land_is_left_out() -> None:
    """Half of the image is land, half is calm water, which returns nothing."""
    rng = np.random.default_rng(12)
    land = make_tape((256, 256), rng, **TAPES["wide response"])
    image = np.hstack([land, circular(rng, (256, 256)).astype(np.complex64)])
    found = find_pure_speckle(image)
    assert found.pure[:, :4].sum() >= 15
    assert found.counts()["like noise"] >= 15


def test_small_images_have_small_tiles() -> None:
    white = circular(np.random.default_rng(9), (185, 12))
    found = find_pure_speckle((white[1:] + white[:-1]).astype(np.complex64), noise_power=0.0)
    assert found.tile == (64, 12)
    assert found.pure.tolist() == [[True], [True]]


def test_an_image_of_targets_has_no_pure_speckle() -> None:
    targets = tuple(TapeTarget(32 + 64 * i, 32 + 64 * j, 40) for i in range(2) for j in range(2))
    image = make_tape((128, 128), np.random.default_rng(10), targets, RangeFault(), AzimuthFault())
    with refused(NotDetermined, "4 tiles", "4 moment", "needed"):
        find_pure_speckle(image)
    with pytest.raises(NotDetermined, match="4 not finite"):
        find_pure_speckle(np.full((128, 128), np.nan, dtype=np.complex64))


def test_images_that_are_none_are_refused() -> None:
    for wrong in (np.ones((64, 64), np.float32), np.ones((2, 64, 64), np.complex64)):
        with refused(UserError, "complex"):
            find_pure_speckle(wrong)
    with refused(NotDetermined, "4 x 200", "8 pixels"):
        find_pure_speckle(np.ones((4, 200), np.complex64))
