"""What an image can tell of the pose: information, Cramer-Rao bound, and the directions it leaves free."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.frames import rotate_position_block
from craternav_fg.resection.problem import ResectionProblem
from craternav_fg.resection.solve_kernel import invert, normal_equations

FloatArray = npt.NDArray[np.float64]

# A direction of the pose with a larger standard deviation, in radians or parts of the range to the craters,
# is free: no linearisation reaches so far.
MAX_SIGMA = 0.5
# Part of a named motion that must lie in the free directions to give them its name.
_NAMED_SHARE = 0.98
_EMPTY = np.empty((0, 0))
_NO_SUN = np.empty(0)


@dataclass(frozen=True)
class Observability:
    """Which directions of the pose an image determines.

    Attributes
    ----------
    rank : int
        Directions, of 6 (of 3 with the attitude known exactly), with a standard deviation below
        `MAX_SIGMA`.
    free : ndarray, shape (k, 6)
        The other directions: orthonormal right twists [w, rho], rho in units of the range.
    words : tuple of str, length k
        The same in words.
    sigmas : ndarray
        Standard deviations along the principal directions, rad or parts of the range, the largest
        first; inf where nothing is known.
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
        For the right twist [w, rho], rad and m in body axes; NaN when a direction is free.
    observability : Observability
    """

    covariance: FloatArray
    observability: Observability

    @property
    def position_rms_m(self) -> float:
        """Least root mean square of the position's error, m."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def attitude_rms_rad(self) -> float:
        """Least root mean square of the attitude's error, rad."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))


def cramer_rao(problem: ResectionProblem, gTb: FloatArray) -> Bound:
    """Bound of any unbiased estimate at a true pose.

    Parameters
    ----------
    problem : ResectionProblem
        Its charts' covariances should be those at the true pose; the measured charts and the measured
        tilt do not matter.
    gTb : ndarray, shape (4, 4)
        True pose; the bound of a prior is that of one about this pose.
    """
    N = information(problem, gTb)
    seen = observability(problem, gTb, N)
    return Bound(covariance_of(N, problem) if not len(seen.free) else np.full((6, 6), np.nan), seen)


def information(problem: ResectionProblem, gTb: FloatArray) -> FloatArray:
    """Information (6, 6) for the right twist at a pose; of an exactly known attitude, as if it were not."""
    N = np.empty((6, 6))
    prior, weight = prior_arrays(problem)
    normal_equations(
        np.ascontiguousarray(gTb, dtype=np.float64), problem.bTc, problem.rims.packed(problem.bTc), prior,
        weight, sun_array(problem), 1.0, np.empty((7, 5 * len(problem.rims))), N, np.empty(6),
    )  # fmt: skip
    return N


def first_free(problem: ResectionProblem) -> int:
    """First of the six coordinates that is estimated: 3 when the attitude is exact, or 0."""
    return 3 if problem.attitude is not None and problem.attitude.sigma_rad == 0.0 else 0


def covariance_of(N: FloatArray, problem: ResectionProblem) -> FloatArray:
    """Covariance (6, 6) of an information that determines the pose; NaN where it does not."""
    out = np.empty((6, 6))
    invert(np.ascontiguousarray(N), first_free(problem), out)
    return out


def observability(problem: ResectionProblem, gTb: FloatArray, N: FloatArray) -> Observability:
    """Judge which directions an information N (6, 6) at a pose determines."""
    first = first_free(problem)
    range_m = range_to(problem, gTb)
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


def range_to(problem: ResectionProblem, gTb: FloatArray) -> float:
    """Distance from the camera to the craters' middle, m."""
    middle = np.add.reduce(problem.rims.centres) / len(problem.rims)
    return float(math.dist(gTb[:3, :3] @ problem.bTc[:3, 3] + gTb[:3, 3], middle))


def prior_arrays(problem: ResectionProblem) -> tuple[FloatArray, FloatArray]:
    """Give pose (4, 4) and weight (6, 6) of what is known before, as the kernels take them; or (0, 0)."""
    if problem.prior is not None:
        covariance = rotate_position_block(problem.prior.covariance, problem.prior.gTb[:3, :3])
        return problem.prior.gTb, np.asarray(np.linalg.inv(covariance))
    if problem.attitude is not None and problem.attitude.sigma_rad > 0.0:
        expected = np.eye(4)
        expected[:3, :3] = problem.attitude.gRb
        return expected, np.diag([problem.attitude.sigma_rad**-2] * 3 + [0.0] * 3)
    return np.eye(4), _EMPTY


def sun_array(problem: ResectionProblem) -> FloatArray:
    """Sun's tilt as the kernels take it, shape (7,), or (0,) without."""
    sun = problem.sun
    if sun is None:
        return _NO_SUN
    return np.array([*sun.direction, *sun.point, sun.tilt_rad, sun.sigma_rad], dtype=np.float64)


def _words(problem: ResectionProblem, gTb: FloatArray, free: FloatArray, range_m: float) -> tuple[str, ...]:
    """Name the free directions: by the first independent ones of some motions that lie in them."""
    out: list[str] = []
    left = free
    for name, twist in _motions(problem, gTb):
        v = np.concatenate([twist[:3], twist[3:] / range_m])
        v /= np.linalg.norm(v)
        within = free.T @ (free @ v)
        if np.linalg.norm(within) < _NAMED_SHARE:
            continue
        # What is new in it.
        part = left @ v
        if np.linalg.norm(part) < 0.5:
            continue
        out.append(name)
        direction = part / np.linalg.norm(part)
        basis, _, _ = np.linalg.svd(np.eye(len(left)) - np.outer(direction, direction))
        left = basis[:, : len(left) - 1].T @ left
        if not len(left):
            return tuple(out)
    whose = f"crater {problem.rims.identifiers[0]!r}" if len(problem.rims) == 1 else "all craters"
    return (*out, *(f"a motion that leaves the image of {whose} as it is: {_plainly(v)}" for v in left))


def _motions(problem: ResectionProblem, gTb: FloatArray) -> list[tuple[str, FloatArray]]:
    """Motions that have a name, as right twists [w, rho], rad and m."""
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
                    f"swing round the centre of crater {name!r} about the image's {letter} axis, with the "
                    "view held on it",
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
        out.append((f"rotation of the camera about its {letter} axis, in place", about(axis, gPc)))
    for axis, letter in zip(gRc.T, "xyz", strict=True):
        out.append(
            (f"translation along the camera's {letter} axis", np.concatenate([np.zeros(3), gRb.T @ axis]))
        )
    return out


def _plainly(v: FloatArray) -> str:
    w, rho = (", ".join(f"{x:.2f}" for x in part) for part in (v[:3], v[3:]))
    return f"rotation ({w}) rad with translation ({rho}) of the range, in body axes"
