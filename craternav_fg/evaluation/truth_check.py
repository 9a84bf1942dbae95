"""Mistakes of a ground truth that look like a failed estimator, recognised by the pattern of the errors."""

import itertools
from collections.abc import Iterator

import numpy as np

from craternav_fg import frames
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

# A mistake is certain if the errors are so many times smaller without it, and if it is so large: an attitude,
# and a constant turn about the body's axis.
_CERTAIN = 20.0
_MIN_ATTITUDE_RAD, _MIN_TURN_RAD = np.radians(10.0), np.radians(3.0)


def doubted_truth(
    estimate: Trajectory, truth: Trajectory, spin_rad_s: tuple[float, float, float]
) -> list[str]:
    """Find out whether the truth, not an estimate, is in another frame or has another form of attitudes.

    Parameters
    ----------
    estimate, truth : Trajectory
        At the same stamps.
    spin_rad_s : tuple of float
        The body's angular velocity in inertial space, components in g.

    Returns
    -------
    list of str
        Warnings: mistakes that explain nearly all of the errors.
    """
    found = [*_positions(estimate, truth, np.array(spin_rad_s)), *_axes(estimate, truth)]
    # A short path that is mirrored looks turned, too, but not to the metre.
    best = sorted(found, key=lambda one: one[0])[:1]
    return [*_attitudes(estimate, truth), *(text for _, text in best)]


def _attitudes(estimate: Trajectory, truth: Trajectory) -> Iterator[str]:
    found_rad = _angle_rad(estimate.gRb, truth.gRb)
    if found_rad < _MIN_ATTITUDE_RAD:
        return
    q = frames.to_quaternion_wxyz(truth.gRb)
    for mistake, gRb in (
        ("quaternions as x, y, z, w", frames.from_quaternion_wxyz(q[:, [3, 0, 1, 2]])),
        ("the attitude of g in b", np.swapaxes(truth.gRb, 1, 2)),
    ):
        left_rad = _angle_rad(estimate.gRb, gRb)
        if _CERTAIN * left_rad < found_rad:
            yield (
                f"the truth, not the estimate, seems to give {mistake}: read so, it differs by "
                f"{np.degrees(left_rad):.2g} deg instead of {np.degrees(found_rad):.3g} deg"
            )


def _positions(estimate: Trajectory, truth: Trajectory, spin: FloatArray) -> Iterator[tuple[float, str]]:
    """Frames that turn with a body or do not: the distance that is left, m, and what to say."""
    rate = float(np.linalg.norm(spin))
    # At a single time, a turn about the axis is any error in longitude.
    if rate == 0.0 or len(truth) < 2:
        return
    axis, seconds = spin / rate, 1e-9 * (truth.stamps_ns - truth.stamps_ns[0])
    lead_rad = _lead_rad(estimate.gP, truth.gP, axis)
    found_m = _rms_m(truth.gP - estimate.gP)
    from_axis_m = float(np.linalg.norm(np.cross(axis, estimate.gP), axis=1).mean())
    for mistake, turned_rad in (
        ("be in inertial space", rate * seconds),
        ("have another prime meridian", np.zeros(len(truth))),
    ):
        # Of inertial space nobody knows how it is turned at the first frame.
        offset_rad = float(np.angle(np.mean(np.exp(1j * (lead_rad - turned_rad)))))
        back = frames.rotation_exp(-(turned_rad + offset_rad)[:, None] * axis)
        left_m = _rms_m(np.einsum("kij,kj->ki", back, truth.gP) - estimate.gP)
        # What tells one from the other must be larger than what is left, too.
        told_rad = turned_rad[-1] or (abs(offset_rad) if abs(offset_rad) > _MIN_TURN_RAD else 0.0)
        if _CERTAIN * left_m < min(found_m, from_axis_m * told_rad):
            text = (
                f"the truth, not the estimate, seems to {mistake}: turned back about the body's axis, its "
                f"positions differ by {left_m:.3g} m RMS instead of {found_m:.3g} m"
            )
            yield left_m, text
            return


def _axes(estimate: Trajectory, truth: Trajectory) -> Iterator[tuple[float, str]]:
    """Columns that are interchanged, or a frame that is left-handed: as `_positions`."""
    found_m = _rms_m(truth.gP - estimate.gP)
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            left_m = _rms_m(truth.gP[:, order] * signs - estimate.gP)
            if _CERTAIN * left_m < found_m:
                names = [
                    f"{'-' if sign < 0.0 else ''}{'xyz'[k]}" for sign, k in zip(signs, order, strict=True)
                ]
                text = (
                    f"the truth, not the estimate, seems to have other axes: with its {', '.join(names)} for "
                    f"x, y, z, its positions differ by {left_m:.3g} m RMS instead of {found_m:.3g} m"
                )
                yield left_m, text


def _lead_rad(gP: FloatArray, true_gP: FloatArray, axis: FloatArray) -> FloatArray:
    """Angles (k,) about an axis from positions to the true ones."""
    across = np.sum(gP * true_gP, axis=1) - (gP @ axis) * (true_gP @ axis)
    return np.asarray(np.arctan2(np.cross(gP, true_gP) @ axis, across))


def _angle_rad(gRb: FloatArray, true_gRb: FloatArray) -> float:
    """Median angle between attitudes (k, 3, 3)."""
    turn = frames.rotation_log(np.swapaxes(gRb, 1, 2) @ true_gRb)
    return float(np.median(np.linalg.norm(turn, axis=1)))


def _rms_m(offsets: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(offsets**2, axis=1))))
