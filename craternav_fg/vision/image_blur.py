"""How blurred an image is, by its spectrum.

The brightness of rough ground has a power law as its spectrum, at scales between its hills and its stones; a
Gaussian point-spread function multiplies it by a Gaussian, and the detector adds white noise. The exponent of
the power law, the width of the point-spread function and the noise are fitted together. Ground that is smooth
at the scale of a pixel looks blurred, by some tenths of a pixel on rendered ground; compressed images have
noise that is not white, and look sharper.
"""

import numpy as np

from factors.arrays import FloatArray, ImageArray

# Tiles whose spectra are averaged, px; they overlap by half.
_TILE_PX = 128
# Tiles that tell nothing: in the shadow, saturated, or without any contrast. Brightness, 0 to 255.
_DARKEST, _BRIGHTEST, _LEAST_CONTRAST = 8.0, 252.0, 1.0
# Frequencies, cycles per pixel: below, hills are not rough; beyond, there are the corners of the spectrum.
_FREQUENCIES = np.arange(0.03, 0.49, 0.01)
# Ratio of misfits of widths that cannot be told apart.
_NEARLY_AS_WELL = 1.3
# Widths, px, and exponents that are tried.
_WIDTHS_PX, _EXPONENTS = np.arange(0.0, 4.01, 0.05), np.arange(1.0, 5.01, 0.25)


def blur_px(image: ImageArray) -> float | None:
    """Estimate the width of the point-spread function of an image of rough ground.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255.

    Returns
    -------
    float or None
        Standard deviation, px, at most 4; None where no part of the image tells it.
    """
    spectrum = _spectrum(image)
    return None if spectrum is None else _width_px(spectrum)


def _spectrum(image: ImageArray) -> FloatArray | None:
    """Mean power (m,) of the tiles at the frequencies."""
    window = np.hanning(_TILE_PX)[:, None] * np.hanning(_TILE_PX)
    height, width = image.shape
    power, count = np.zeros((_TILE_PX, _TILE_PX)), 0
    for y in range(0, height - _TILE_PX + 1, _TILE_PX // 2):
        for x in range(0, width - _TILE_PX + 1, _TILE_PX // 2):
            tile = image[y : y + _TILE_PX, x : x + _TILE_PX]
            mean = float(tile.mean())
            if mean < _DARKEST or tile.max() > _BRIGHTEST or tile.std() < _LEAST_CONTRAST:
                continue
            power += np.abs(np.fft.fft2((tile - mean) * window)) ** 2
            count += 1
    if not count:
        return None
    each = np.fft.fftfreq(_TILE_PX)
    bins = np.digitize(np.hypot(each[:, None], each), _FREQUENCIES)
    total = np.bincount(bins.ravel(), power.ravel())[1 : len(_FREQUENCIES)]
    return np.asarray(total / np.bincount(bins.ravel())[1 : len(_FREQUENCIES)] / count)


def _width_px(spectrum: FloatArray) -> float:
    """Width of the Gaussian with which a power law and white noise are nearest to a spectrum (m,)."""
    f = 0.5 * (_FREQUENCIES[1:] + _FREQUENCIES[:-1])
    law = f ** -_EXPONENTS[:, None] * np.exp(-((2.0 * np.pi * _WIDTHS_PX[:, None, None] * f) ** 2))
    # Share of law and noise in the spectrum, by least squares of ratios to it; neither below zero.
    a, b = law / spectrum, np.broadcast_to(1.0 / spectrum, law.shape)
    aa, ab, bb = (np.sum(x * y, axis=-1) for x, y in ((a, a), (a, b), (b, b)))
    noise = (aa * b.sum(axis=-1) - ab * a.sum(axis=-1)) / (aa * bb - ab * ab)
    noise = np.maximum(noise, 0.0)
    share = np.maximum((a.sum(axis=-1) - noise * ab) / aa, np.finfo(np.float64).tiny)
    found = share[..., None] * a + noise[..., None] * b
    misfit = np.sum(np.log(np.maximum(found, np.finfo(np.float64).tiny)) ** 2, axis=-1).min(axis=1)
    # Where noise hides the power law, any width fits: the smallest one that fits nearly as well as the best.
    return float(_WIDTHS_PX[np.argmax(misfit <= _NEARLY_AS_WELL * misfit.min())])
