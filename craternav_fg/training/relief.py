"""Ground before any crater falls on it: rough and rolling, with ridges, troughs and scarps."""

import cv2
import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]

# Share of grounds with ridges, troughs or scarps.
_LINE_SHARE = 0.5


def relief(rng: np.random.Generator, side_px: int) -> Float32Array:
    """Make ground without craters.

    Parameters
    ----------
    rng : Generator
    side_px : int

    Returns
    -------
    ndarray of float32, shape (side_px, side_px)
        Heights in pixels.
    """
    heights = fractal(rng, side_px, rng.uniform(1.5, 2.4)) * np.float32(10.0 ** rng.uniform(-0.6, 1.0))
    if rng.random() < _LINE_SHARE:
        heights += _lines(rng, side_px)
    return heights


def fractal(rng: np.random.Generator, side_px: int, exponent: float) -> Float32Array:
    """Draw a random field with a power law of amplitudes, periodic, of unit variance.

    Parameters
    ----------
    rng : Generator
    side_px : int
    exponent : float
        Amplitudes fall with the frequency to this power.

    Returns
    -------
    ndarray of float32, shape (side_px, side_px)
        Dimensionless.
    """
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(side_px), np.fft.rfftfreq(side_px), indexing="ij"))
    f[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((side_px, side_px))) * f**-exponent
    field = np.fft.irfft2(spectrum, s=(side_px, side_px))
    return np.asarray(field / field.std(), dtype=np.float32)


def _lines(rng: np.random.Generator, side_px: int) -> Float32Array:
    """Heights of ridges, troughs or scarps along the zeros of a smooth random field, here and there."""
    field = fractal(rng, side_px, rng.uniform(1.9, 2.6))
    slope = np.hypot(cv2.Scharr(field, cv2.CV_32F, 1, 0), cv2.Scharr(field, cv2.CV_32F, 0, 1)) / 32.0
    width_px = 10.0 ** rng.uniform(0.4, 1.5)
    # About the distance from the line, in widths.
    off = field / ((slope + 0.3 * np.median(slope)) * np.float32(width_px))
    kind = rng.random()
    height_px = width_px * rng.uniform(0.1, 0.5) * (1.0 if kind < 0.6 else -1.0)
    profile = np.exp(-off * off) if kind < 0.8 else np.tanh(off)
    here = 1.0 / (1.0 + np.exp(-4.0 * fractal(rng, side_px, 2.2)))
    return np.asarray(np.float32(height_px) * profile * here, dtype=np.float32)
