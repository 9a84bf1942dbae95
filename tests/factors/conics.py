"""Ellipse charts of conics."""

import numpy as np


def conic_to_chart(q: np.ndarray) -> np.ndarray:
    """Return the ellipse chart of a conic of any sign and scale; NaN when it is no ellipse."""
    A, B, C, D, E, F = q
    det = 4.0 * A * C - B * B
    if not det > 0.0:
        return np.full(5, np.nan)
    mx, my = (B * E - 2.0 * C * D) / det, (B * D - 2.0 * A * E) / det
    # (u - m)' M (u - m) = k
    k = -(F + 0.5 * (D * mx + E * my))
    sxx, sxy, syy = 4.0 * k * C / det, -2.0 * k * B / det, 4.0 * k * A / det
    if not sxx > 0.0 or not syy > sxy * sxy / sxx:
        return np.full(5, np.nan)
    return np.array([mx, my, 0.5 * np.log(sxx), sxy / sxx, 0.5 * np.log(syy - sxy * sxy / sxx)])
