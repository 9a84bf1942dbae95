"""The width of the point-spread function is that with which rough ground was blurred."""

import cv2
import numpy as np
import pytest

from craternav_fg.vision.image_blur import blur_px


def rough_ground(exponent: float, side: int = 512) -> np.ndarray:
    """Noise with a power law as its spectrum, 0 to 255, sampled twice as finely as a pixel."""
    rng = np.random.default_rng(7)
    each = np.fft.fftfreq(2 * side)
    frequency = np.hypot(each[:, None], each)
    frequency[0, 0] = 1.0
    values = np.fft.ifft2(
        np.fft.fft2(rng.standard_normal(frequency.shape)) * frequency ** (-0.5 * exponent)
    ).real
    return np.asarray(110.0 + 25.0 * values / values.std(), np.float32)


@pytest.mark.parametrize("exponent", [1.5, 2.5, 3.5])
@pytest.mark.parametrize("width_px", [0.6, 0.9, 1.4, 2.2])
def test_the_width_is_found_whatever_the_ground(exponent: float, width_px: float) -> None:
    fine = cv2.GaussianBlur(rough_ground(exponent), (0, 0), 2.0 * width_px)
    image = fine[::2, ::2] + np.random.default_rng(1).normal(0.0, 0.7, (512, 512)).astype(np.float32)
    found = blur_px(np.clip(np.rint(image), 0.0, 255.0).astype(np.float32))
    assert found == pytest.approx(width_px, abs=0.12)


@pytest.mark.parametrize("sigma", [1.2, 3.0, 8.0])
def test_noise_is_no_blur(sigma: float) -> None:
    """Any width fits noise alone: images of plains seemed to be blurred by 2 to 4 px."""
    noise = np.random.default_rng(3).normal(0.0, sigma, (512, 512))
    ramp = np.linspace(100.0, 110.0, 512)
    for ground in (0.0, 0.04 * (rough_ground(4.0)[::2, ::2] - 110.0)):
        found = blur_px(np.rint(ramp + ground + noise).astype(np.float32))
        assert found is not None
        assert found < 0.7


def test_images_that_show_nothing_tell_nothing() -> None:
    ground = cv2.GaussianBlur(rough_ground(2.0), (0, 0), 2.0)[::2, ::2]
    assert blur_px(np.zeros((512, 512), np.float32)) is None
    assert blur_px(np.full((512, 512), 120.0, np.float32)) is None
    assert blur_px(ground[:100]) is None
    assert blur_px(np.clip(4.0 * ground, 0.0, 255.0)) is None
    # Shadows and overexposed parts are left out.
    half = np.where(np.arange(1024) < 400, 0.0, rough_ground(2.0)).astype(np.float32)
    half = cv2.GaussianBlur(half, (0, 0), 2.0)[::2, ::2]
    assert blur_px(half) == pytest.approx(blur_px(ground), abs=0.2)
