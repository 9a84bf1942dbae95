"""Information of an image about the pose: Cramer-Rao bound, and the directions that stay undetermined."""

from dataclasses import dataclass

import numpy as np

from craternav_fg.resection.problem import ResectionProblem
from craternav_fg.resection.solve_kernel import covariance_and_log_det, normal_equations
from factors.arrays import FloatArray

# A direction of the pose with a larger standard deviation, rad or share of the range to the craters, counts
# as undetermined: beyond about half a radian the linearisation says nothing.
MAX_SIGMA = 0.5
# Share of a named motion that must lie in the undetermined directions for them to be called by its name, and
# share that must be independent of the motions named before.
_NAMED_SHARE = 0.98
_NEW_SHARE = 0.5


@dataclass(frozen=True)
class Observability:
    """Which directions of the pose an image determines.

    Attributes
    ----------
    rank : int
        Number of directions, of 6 (of 3 with an exactly known attitude), with a standard deviation below
        `MAX_SIGMA`.
    free : ndarray, shape (k, 6)
        The other directions: orthonormal right twists [w, rho] in b, rho in units of the range.
    words : tuple of str, length k
        Descriptions of the other directions.
    sigmas : ndarray, shape (6,) or (3,)
        Standard deviations along the principal directions of the twist, rad or share of the range, the
        largest first; inf where nothing is known.
    """

    rank: int
    free: FloatArray
    words: tuple[str, ...]
    sigmas: FloatArray


@dataclass(frozen=True)
class Bound:
    """Cramer-Rao bound of a pose.

    Attributes
    ----------
    covariance : ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b; NaN when a direction is undetermined.
    observability : Observability
    """

    covariance: FloatArray
    observability: Observability

    @property
    def position_rms_m(self) -> float:
        """Lower bound of the root mean square of the position's error."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


def cramer_rao(problem: ResectionProblem, gTb: FloatArray) -> Bound:
    """Compute the Cramer-Rao bound of unbiased estimates at a true pose.

    Parameters
    ----------
    problem : ResectionProblem
        The charts' covariances should be those at the true pose; the measured charts and the measured tilt
        are not used.
    gTb : ndarray, shape (4, 4)
        True pose. A prior is taken to be centred on it.

    Returns
    -------
    Bound
    """
    N = information(problem, gTb)
    seen = observability(problem, gTb, N)
    if len(seen.free):
        return Bound(np.full((6, 6), np.nan), seen)
    covariance = np.empty((6, 6))
    covariance_and_log_det(N, problem.first_free, covariance)
    return Bound(covariance, seen)


def information(problem: ResectionProblem, gTb: FloatArray) -> FloatArray:
    """Compute the information about the pose.

    Parameters
    ----------
    problem : ResectionProblem
    gTb : ndarray, shape (4, 4)
        Pose at which to linearise.

    Returns
    -------
    ndarray, shape (6, 6)
        For the right twist [w, rho], rad and m in b. An exactly known attitude is not included.
    """
    N = np.empty((6, 6))
    prior, weight = problem.prior_arrays()
    normal_equations(
        np.ascontiguousarray(gTb, dtype=np.float64), problem.bTc, problem.rims.packed(problem.bTc), prior,
        weight, problem.sun_array(), 1.0, np.empty((7, 5 * len(problem.rims))), N, np.empty(6),
    )  # fmt: skip
    return N


def observability(problem: ResectionProblem, gTb: FloatArray, N: FloatArray) -> Observability:
    """Find the directions that an information matrix determines.

    Parameters
    ----------
    problem : ResectionProblem
    gTb : ndarray, shape (4, 4)
        Pose of the linearisation.
    N : ndarray, shape (6, 6)
        Information, see `information`.

    Returns
    -------
    Observability
    """
    first = problem.first_free
    range_m = problem.range_m(gTb)
    scale = np.array([1.0, 1.0, 1.0, range_m, range_m, range_m])[first:]
    values, vectors = np.linalg.eigh(N[first:, first:] * np.outer(scale, scale))
    with np.errstate(divide="ignore"):
        sigmas = 1.0 / np.sqrt(np.maximum(values, 0.0))
    loose = ~(sigmas <= MAX_SIGMA)
    free = np.zeros((int(loose.sum()), 6))
    free[:, first:] = vectors[:, loose].T
    return Observability(
        6 - first - len(free), free, _words(problem, gTb, free, range_m) if len(free) else (), sigmas
    )


def _words(problem: ResectionProblem, gTb: FloatArray, free: FloatArray, range_m: float) -> tuple[str, ...]:
    """Describe the undetermined directions by named motions where such lie in them, else by numbers."""
    out: list[str] = []
    left = free
    for name, twist in _motions(problem, gTb):
        v = np.concatenate([twist[:3], twist[3:] / range_m])
        v /= np.linalg.norm(v)
        within = free.T @ (free @ v)
        if np.linalg.norm(within) < _NAMED_SHARE:
            continue
        part = left @ v
        if np.linalg.norm(part) < _NEW_SHARE:
            continue
        out.append(name)
        # Remove this motion from the directions that have no name yet.
        direction = part / np.linalg.norm(part)
        basis, _, _ = np.linalg.svd(np.eye(len(left)) - np.outer(direction, direction))
        left = basis[:, : len(left) - 1].T @ left
        if not len(left):
            return tuple(out)
    whose = f"crater {problem.rims.identifiers[0]!r}" if len(problem.rims) == 1 else "all craters"
    return (*out, *(f"a motion that does not change the image of {whose}: {_numbers(v)}" for v in left))


def _motions(problem: ResectionProblem, gTb: FloatArray) -> list[tuple[str, FloatArray]]:
    """Motions that have a name, as right twists [w, rho] in b, rad and m."""
    gRb = gTb[:3, :3]
    gPc = gRb @ problem.bTc[:3, 3] + gTb[:3, 3]
    gRc = gRb @ problem.bTc[:3, :3]

    def about(axis: FloatArray, point: FloatArray) -> FloatArray:
        return np.concatenate([gRb.T @ axis, gRb.T @ np.cross(axis, gTb[:3, 3] - point)])

    out = []
    rims = problem.rims
    for name, centre, normal in zip(rims.identifiers, rims.centres, rims.normals, strict=True):
        sight = (centre - gPc) / np.linalg.norm(centre - gPc)
        out.append(
            (f"rotation about the normal of crater {name!r} through its centre", about(normal, centre))
        )
        across = np.cross(sight, gRc[:, 0])
        across /= np.linalg.norm(across)
        for axis, letter in ((np.cross(across, sight), "x"), (across, "y")):
            out.append(
                (
                    f"rotation of the camera around the centre of crater {name!r} about the image's {letter} "
                    "axis, still pointing at it",
                    about(axis, centre),
                )
            )
        out.append(
            (
                f"translation along the line of sight to crater {name!r}",
                np.concatenate([np.zeros(3), gRb.T @ sight]),
            )
        )
    for axis, letter in zip(gRc.T, "xyz", strict=True):
        out.append((f"rotation of the camera about its {letter} axis", about(axis, gPc)))
    for axis, letter in zip(gRc.T, "xyz", strict=True):
        out.append(
            (f"translation along the camera's {letter} axis", np.concatenate([np.zeros(3), gRb.T @ axis]))
        )
    return out


def _numbers(v: FloatArray) -> str:
    """Twist (6,) as text."""
    w, rho = (", ".join(f"{x:.2f}" for x in part) for part in (v[:3], v[3:]))
    return f"rotation ({w}) rad with translation ({rho}) of the range, in body axes"
