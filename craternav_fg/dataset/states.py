"""States over time on disk, true or a-priori ones: read, checked, and interpolated at the frames' stamps."""

from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.dataset import layout
from craternav_fg.dataset.description import deep_in_body, too_deep
from craternav_fg.errors import InputError
from craternav_fg.files import exists
from craternav_fg.frames import from_quaternion_wxyz
from craternav_fg.tables import Table, read_table
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray

# Longest gap of known states in which a frame is interpolated: in low orbit a cubic errs by millimetres then.
# A longer one may hide a whole burn or slew.
MAX_STATE_GAP_S = 30.0
# Largest deviation of the length of unit vectors and quaternions from 1, from numbers of seven digits.
_UNIT_TOLERANCE = 1e-6
# Fewer rows do not tell how the acceleration changes between them.
_MIN_ROWS_OF_MOTION = 4
# Velocities contradict the positions if they are off by so many times what coarse or noisy rows explain, and
# by this share of the speed; or by that of the body's rotation, up to this share of it.
_CONTRADICTION, _SPEED_SHARE, _SPIN_SHARE = 5.0, 0.1, 0.2


def read_states(path: Path, frames_ns: IntArray, body: Body, *, one_motion: bool) -> Trajectory | None:
    """Read states at the stamps of frames, interpolated where the file has others.

    Parameters
    ----------
    path : Path
    frames_ns : ndarray of int, shape (k,)
        Increasing.
    body : Body
    one_motion : bool
        Whether all rows are of one motion, so that velocities must fit the positions.

    Returns
    -------
    Trajectory or None
        None without the file.

    Raises
    ------
    InputError
        When the file is wrong, does not reach over the frames, or has too large a gap around one; also for
        positions deep in the body, and velocities that contradict the positions.
    """
    if not exists(path):
        return None
    table = read_table(path, layout.TRUTH_COLUMNS)
    if not len(table):
        raise InputError(path, "expected at least one row, found none")
    table.require_increasing(layout.STAMP)
    stamps: IntArray = table.columns[layout.STAMP]
    if stamps[0] > frames_ns[0] or stamps[-1] < frames_ns[-1]:
        raise InputError(
            path,
            f"expected states over the frames, {frames_ns[0]} to {frames_ns[-1]} ns,"
            f" found {stamps[0]} to {stamps[-1]} ns",
        )
    q = table.numbers(*layout.ATTITUDE)
    require_unit(table, q, layout.ATTITUDE, "quaternion")
    P, V, bias = (table.numbers(*names) for names in (layout.POSITION, layout.VELOCITY, layout.BIAS))
    _require_outside(table, P, body)
    if one_motion:
        _require_one_motion(path, stamps, P, V, body)
    gTb = np.tile(np.eye(4), (len(frames_ns), 1, 1))
    if np.isin(frames_ns, stamps).all():
        rows = np.searchsorted(stamps, frames_ns)
        gTb[:, :3, :3], gTb[:, :3, 3] = from_quaternion_wxyz(q[rows]), P[rows]
        return Trajectory(frames_ns, gTb, V[rows], bias[rows])
    _require_near(table, stamps, frames_ns)
    t, at = (stamps - stamps[0]) * 1e-9, (frames_ns - stamps[0]) * 1e-9
    # Imported here: a command that reads one image needs neither, and they take a quarter of a second.
    from scipy.interpolate import CubicHermiteSpline
    from scipy.spatial.transform import Rotation, Slerp

    position, attitude = CubicHermiteSpline(t, P, V), Slerp(t, Rotation.from_quat(q, scalar_first=True))
    gTb[:, :3, :3], gTb[:, :3, 3] = attitude(at).as_matrix(), position(at)
    biases = np.stack([np.interp(at, t, column) for column in bias.T], axis=-1)
    return Trajectory(frames_ns, gTb, position(at, 1), biases)


def _require_near(table: Table, stamps: IntArray, frames_ns: IntArray) -> None:
    """Refuse states that are too far apart around a frame to interpolate between them."""
    between = frames_ns[~np.isin(frames_ns, stamps)]
    after = np.searchsorted(stamps, between)
    gap_ns = stamps[after] - stamps[after - 1]
    far = np.flatnonzero(gap_ns > 1e9 * MAX_STATE_GAP_S)
    if len(far):
        k = int(far[0])
        row = int(after[k])
        table.fail(
            row,
            layout.STAMP,
            f"expected states at most {MAX_STATE_GAP_S:g} s apart around frame {between[k]},"
            f" found a gap of {1e-9 * gap_ns[k]:.3f} s from {stamps[row - 1]} to {stamps[row]}",
        )


def _require_outside(table: Table, P: FloatArray, body: Body) -> None:
    """Refuse positions (n, 3) deep in the body."""
    for row in np.flatnonzero(deep_in_body(P, body.radius_m)).tolist():
        table.fail(row, ",".join(layout.POSITION), too_deep(P[row]))


def _require_one_motion(path: Path, stamps: IntArray, P: FloatArray, V: FloatArray, body: Body) -> None:
    """Refuse velocities that are not those of the positions, on average over all rows."""
    # Divided, as thirty seconds are more than 30.0 once multiplied by 1e-9.
    step_s = np.diff(stamps) / 1e9
    used = step_s <= MAX_STATE_GAP_S
    if len(stamps) < _MIN_ROWS_OF_MOTION or not used.any():
        return
    duration_s = step_s[used].sum()
    moved_m = np.diff(P, axis=0)
    off_m = moved_m - 0.5 * (V[1:] + V[:-1]) * step_s[:, None]
    off_m_s = off_m[used].sum(axis=0) / duration_s
    # Where the acceleration changes within a step, a mean of two velocities errs; where positions are noisy,
    # all steps do.
    change_m_s2 = np.linalg.norm(np.diff(np.diff(V, axis=0) / step_s[:, None], axis=0), axis=1)
    changes_m_s2 = np.append(change_m_s2, 0.0) + np.insert(change_m_s2, 0, 0.0)
    scatter_m = np.sqrt(np.mean(np.sum((off_m - off_m_s * step_s[:, None])[used] ** 2, axis=1)))
    explained_m_s = (np.sum((changes_m_s2 * step_s**2)[used]) / 8.0 + scatter_m) / duration_s
    spin_m_s = np.cross(np.array(body.spin_rad_s), 0.5 * (P[1:] + P[:-1])[used]).mean(axis=0)
    found, rotation, excess = (float(np.linalg.norm(v)) for v in (off_m_s, spin_m_s, off_m_s + spin_m_s))
    speed_m_s = max(
        np.linalg.norm(moved_m[used], axis=1).sum() / duration_s, np.linalg.norm(V, axis=1).mean()
    )
    expected = "expected velocities in m/s, in g and relative to g, as the positions move"
    columns = ",".join(layout.VELOCITY)
    if rotation > _CONTRADICTION * explained_m_s and excess < _SPIN_SHARE * rotation:
        problem = f"{expected}, found the body's rotation beside it, {rotation:.3g} m/s: in inertial space?"
        raise InputError(path, problem, column=columns)
    if found > max(_CONTRADICTION * explained_m_s, _SPEED_SHARE * speed_m_s):
        problem = f"{expected}, found velocities that are off by {found:.3g} m/s on average"
        raise InputError(path, problem, column=columns)


def require_unit(table: Table, vectors: FloatArray, names: tuple[str, ...], what: str) -> None:
    """Refuse vectors that are not of unit length.

    Parameters
    ----------
    table : Table
    vectors : ndarray, shape (n, d)
        Dimensionless; one in each row of the table.
    names : tuple of str
        Their columns.
    what : str
        What they are, for messages.

    Raises
    ------
    InputError
        Naming line and columns.
    """
    norms = np.linalg.norm(vectors, axis=1)
    bad = np.flatnonzero(np.abs(norms - 1.0) > _UNIT_TOLERANCE)
    if len(bad):
        row = int(bad[0])
        table.fail(row, ",".join(names), f"expected a unit {what}, its length is {norms[row]:.9g}")
