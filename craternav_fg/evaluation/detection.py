"""Detected rims against true ones: which belong together, and by how many pixels they differ.

Each ellipse is taken as a Gaussian density with its matrix as the covariance. The overlap of two is the
integral of the square root of their product; the distance is the angle whose cosine is its square (Christian,
Derksen and Watkins 2021, J. Astronaut. Sci. 68, 1056). In units of sigma = 0.85 / sqrt(ab) a detection is a
true rim's when the squared distance is below 13.277, the 99 % quantile of chi-square with four degrees of
freedom, as in NASA's crater detection challenge.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from craternav_fg.ellipse import chart_of_axes, matrix_of_chart
from factors.arrays import BoolArray, FloatArray, IntArray

# Of the challenge's rules: standard deviation of a rim's error, and the 99 % quantile of chi-square with 4
# degrees of freedom.
SIGMA_PX = 0.85
GATE_CHI2 = 13.277


@dataclass(frozen=True)
class Matches:
    """Detections matched to true rims, one to one.

    Attributes
    ----------
    detected, true : ndarray of int, shape (n,)
        Rows that belong together.
    recall : float
        Share of the wanted true rims that were detected; NaN when none is wanted.
    precision : float
        Share of the detections that are true rims, those of unwanted ones left out; NaN without any.
    false : ndarray of int, shape (n_false,)
        Rows of the detections that are no true rim.
    missed : ndarray of int, shape (n_missed,)
        Rows of the wanted true rims that were not detected.
    centre_px, semi_major_px, semi_minor_px : ndarray, shape (k,)
        Errors of the detected wanted rims: distance of the centres, detected minus true axes.
    """

    detected: IntArray
    true: IntArray
    recall: float
    precision: float
    false: IntArray
    missed: IntArray
    centre_px: FloatArray
    semi_major_px: FloatArray
    semi_minor_px: FloatArray


def gaussian_angle(one_px: FloatArray, other_px: FloatArray) -> FloatArray:
    """Angle between the Gaussians of two ellipses.

    Parameters
    ----------
    one_px, other_px : ndarray, shape (..., 5)
        Centre x, y, semi-major and semi-minor axis, px, rotation of the major axis from x to y, rad. Leading
        axes are broadcast.

    Returns
    -------
    ndarray, shape (...,)
        In rad, from 0, for equal ellipses, to pi / 2.
    """
    one, other = (matrix_of_chart(chart_of_axes(axes)) for axes in (one_px, other_px))
    total = one + other
    off = np.asarray(one_px)[..., :2] - np.asarray(other_px)[..., :2]
    # S1^-1 (S1^-1 + S2^-1)^-1 S2^-1 = (S1 + S2)^-1.
    across = np.linalg.solve(total, off[..., None])[..., 0]
    overlap = 4.0 * np.sqrt(_determinant(one) * _determinant(other)) / _determinant(total)
    overlap = overlap * np.exp(-0.5 * np.sum(off * across, axis=-1))
    return np.asarray(np.arccos(np.clip(overlap, 0.0, 1.0)))


def match(
    detected_px: FloatArray,
    true_px: FloatArray,
    wanted: BoolArray | None = None,
    false_counts: BoolArray | None = None,
) -> Matches:
    """Match detections to true rims so that as many as possible agree, and those as closely as possible.

    Parameters
    ----------
    detected_px : ndarray, shape (n, 5)
        Ellipses as in `gaussian_angle`.
    true_px : ndarray, shape (m, 5)
        All rims in the image, px and rad likewise, also those that need not be detected.
    wanted : ndarray of bool, shape (m,), optional
        Rims that must be detected; all if not given. A detection of another one is neither right nor wrong.
    false_counts : ndarray of bool, shape (n,), optional
        Detections that are wrong when they match nothing; all if not given.

    Returns
    -------
    Matches
    """
    detected = np.asarray(detected_px, dtype=np.float64).reshape(-1, 5)
    true = np.asarray(true_px, dtype=np.float64).reshape(-1, 5)
    wanted = np.ones(len(true), dtype=np.bool_) if wanted is None else np.asarray(wanted, dtype=np.bool_)
    counts = np.ones(len(detected), np.bool_) if false_counts is None else np.asarray(false_counts, np.bool_)
    sigma = SIGMA_PX / np.sqrt(true[:, 2] * true[:, 3])
    distance2 = (gaussian_angle(detected[:, None], true[None]) / sigma) ** 2
    # All pairs beyond the gate cost the same, more than any number of pairs within.
    cost = np.where(distance2 < GATE_CHI2, distance2, GATE_CHI2 * (1 + min(distance2.shape)))
    rows, columns = linear_sum_assignment(cost)
    good = distance2[rows, columns] < GATE_CHI2
    rows, columns = rows[good], columns[good]
    right = wanted[columns]
    false = np.setdiff1d(np.flatnonzero(counts), rows)
    missed = np.setdiff1d(np.flatnonzero(wanted), columns)
    hits = int(np.count_nonzero(right))
    error = detected[rows[right]] - true[columns[right]]
    return Matches(
        rows,
        columns,
        _share(hits, len(missed)),
        _share(hits, len(false)),
        false,
        missed,
        np.hypot(error[:, 0], error[:, 1]),
        error[:, 2],
        error[:, 3],
    )


def _determinant(S: FloatArray) -> FloatArray:
    return np.asarray(S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] * S[..., 1, 0])


def _share(right: int, wrong: int) -> float:
    return right / (right + wrong) if right + wrong else float("nan")
