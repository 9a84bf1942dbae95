"""Errors of the map in measured rims, added where a file lacks them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import relative_covariance
from craternav_fg.errors import EstimationError
from craternav_fg.estimators.base import NUMERICAL_ERRORS, Problem
from craternav_fg.estimators.ekf.filter import ekf
from craternav_fg.measurements import MAP_SIZE, TILT_SIZE, ArcSet, FrameMeasurement, RimSet
from craternav_fg.vision.arcs import across_sigma
from craternav_fg.vision.error_model.correlated import (
    CorrelatedErrorOptions,
    map_covariance,
    map_variances,
)
from factors.arrays import BoolArray, FloatArray, IntArray
from factors.kernels.conic import project_rims
from factors.kernels.rim_errors import ground_slopes, tilt_slopes


def lack_map_errors(frames: Sequence[FrameMeasurement], catalog: Catalog) -> bool:
    """Whether the catalogue states errors and measured rims do not hold them.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
    catalog : Catalog

    Returns
    -------
    bool
    """
    every = np.arange(len(catalog))
    return (
        catalog.errors is not None
        and all(frame.rims.of_map is None or frame.rims.map_columns.start for frame in frames)
        and bool(_variances(every, catalog).any())
    )


def with_white_map_errors(
    frames: Sequence[FrameMeasurement], catalog: Catalog, tilt_rad: float = 0.0
) -> tuple[FrameMeasurement, ...]:
    """Add the catalogue's errors to rims as if they were new in each frame: no pose is needed for it.

    For arcs it is, so they are left out.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
    catalog : Catalog
    tilt_rad : float
        Standard deviation of the slopes of rims' planes.

    Returns
    -------
    tuple of FrameMeasurement
    """

    def widened(rims: RimSet) -> RimSet:
        share2 = np.maximum(_variances(rims.craters, catalog).max(axis=1), tilt_rad**2)[:, None, None]
        return replace(rims, covariance=rims.covariance + share2 * relative_covariance(rims.chart, 1.0))

    return tuple(replace(frame, rims=widened(frame.rims), arcs=ArcSet.empty()) for frame in frames)


def with_map_errors(
    frames: Sequence[FrameMeasurement], problems: Sequence[Problem], tilt_rad: float = 0.0
) -> tuple[FrameMeasurement, ...]:
    """Add the catalogue's errors to rims and arcs.

    Where most covariances are large enough to hold these errors already, such ones are only split. Arcs that
    state what their points have in common are left as they are.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
        As the data set holds them.
    problems : sequence of Problem
        With the same frames after `with_white_map_errors`.
    tilt_rad : float
        Standard deviation of the slopes of rims' planes, beside what the rims hold of them.

    Returns
    -------
    tuple of FrameMeasurement
        Those of the problems, where the filter does not find poses.
    """
    camera, catalog = problems[0].camera, problems[0].catalog
    try:
        poses = filtered_poses(problems)
    except (EstimationError, *NUMERICAL_ERRORS):
        return with_white_map_errors(frames, catalog, tilt_rad)
    roots = [_roots(frame, poses, camera, catalog) for frame in frames]
    held = [_held(frame.rims, root) for frame, root in zip(frames, roots, strict=True)]
    images = np.bincount(
        np.concatenate([frame.arcs.craters for frame in frames]).astype(np.int64), minlength=len(catalog)
    )
    if np.mean(np.concatenate([*held, [False]])) <= 0.5:
        held = [np.zeros_like(one) for one in held]
    out = tuple(
        replace(
            frame,
            arcs=_with_common_sigmas(frame.arcs, poses[frame.stamp_ns], camera, catalog, images, tilt_rad),
            rims=replace(
                frame.rims,
                covariance=frame.rims.covariance
                + np.where(one, 0.0, 1.0)[:, None, None] * (root @ np.swapaxes(root, 1, 2)),
                of_map=root
                if frame.rims.of_map is None
                else np.concatenate([root, frame.rims.of_map], axis=2),
            ),
        )
        for frame, root, one in zip(frames, roots, held, strict=True)
    )
    if tilt_rad == 0.0:
        return out
    return with_tilts(out, np.array([poses[frame.stamp_ns] for frame in out]), camera, catalog, tilt_rad)


def _variances(rows: IntArray, catalog: Catalog) -> FloatArray:
    return map_variances(rows, catalog, CorrelatedErrorOptions())


def filtered_poses(problems: Sequence[Problem]) -> dict[int, FloatArray]:
    """Poses of a descent by the filter.

    Parameters
    ----------
    problems : sequence of Problem
        Its segments.

    Returns
    -------
    dict of int to ndarray, shape (4, 4)
        Poses gTb of the body in g, m, by stamp in ns.

    Raises
    ------
    EstimationError
        When the filter fails.
    """
    return {
        frame.stamp_ns: state.gTb
        for problem in problems
        for frame, state in zip(problem.frames, ekf().states(problem), strict=True)
    }


def with_tilts(
    frames: Sequence[FrameMeasurement], gTb: FloatArray, camera: Camera, catalog: Catalog, tilt_rad: float
) -> tuple[FrameMeasurement, ...]:
    """Add slopes of rims' planes to the errors of the map that rims hold.

    Parameters
    ----------
    frames : sequence of FrameMeasurement
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m.
    camera : Camera
    catalog : Catalog
    tilt_rad : float
        Standard deviation of the slopes, beside what the rims hold of them.

    Returns
    -------
    tuple of FrameMeasurement
    """

    def tilted(rims: RimSet, pose: FloatArray) -> RimSet:
        centres, axes = catalog.centres[rims.craters], catalog.axes[rims.craters]
        root = np.asarray(tilt_rad * tilt_slopes(np.ascontiguousarray(pose), camera.bTc, centres, axes))
        covariance = rims.covariance + root @ np.swapaxes(root, 1, 2)
        return replace(rims, covariance=covariance, of_map=_joined(rims.of_map, root))

    return tuple(
        replace(frame, rims=tilted(frame.rims, pose)) for frame, pose in zip(frames, gTb, strict=True)
    )


def _joined(of_map: FloatArray | None, tilts: FloatArray) -> FloatArray:
    """Join roots of errors of the map with those (n, 5, 2) of slopes: a plane has one pair of slopes."""
    if of_map is None:
        return tilts
    if of_map.shape[2] == MAP_SIZE:
        return np.concatenate([of_map, tilts], axis=2)
    held = of_map[:, :, -TILT_SIZE:]
    both = np.copysign(np.hypot(held, tilts), tilts)
    return np.concatenate([of_map[:, :, :-TILT_SIZE], both], axis=2)


def _roots(
    frame: FrameMeasurement, poses: Mapping[int, FloatArray], camera: Camera, catalog: Catalog
) -> FloatArray:
    """Roots (n, 5, 6) of the errors of a frame's craters on the map."""
    rows = frame.rims.craters
    gTb = np.ascontiguousarray(poses[frame.stamp_ns])
    slopes = ground_slopes(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
    return np.asarray(slopes * np.sqrt(_variances(rows, catalog))[:, None])


def _with_common_sigmas(
    arcs: ArcSet, gTb: FloatArray, camera: Camera, catalog: Catalog, images: IntArray, tilt_rad: float
) -> ArcSet:
    """Let the points of an arc share what the errors of its crater move it across its outline.

    They are the same in all images that show the arc of a crater: `images`, by rows of the catalogue.
    """
    if arcs.correlated_sigmas is not None or not len(arcs):
        return arcs
    rows, gTb = arcs.craters, np.ascontiguousarray(gTb)
    charts, _ = project_rims(gTb, camera.bTc, catalog.centres[rows], catalog.axes[rows])
    usual = CorrelatedErrorOptions()
    options = replace(usual, map_tilt_rad=float(np.hypot(usual.map_tilt_rad, tilt_rad)))
    of_map = map_covariance(rows, gTb, camera, catalog, options)
    across = np.array(list(map(across_sigma, arcs.points, charts, of_map)))
    return replace(arcs, correlated_sigmas=across, images=images[rows])


def _held(rims: RimSet, root: FloatArray) -> BoolArray:
    """Whether (n,) covariances are larger than the errors whose root is given, in each direction.

    Those of rims that say what their craters keep beside the map do not hold its errors.
    """
    if not len(rims) or rims.correlated is not None:
        return np.zeros(len(rims), dtype=np.bool_)
    whitened = np.linalg.solve(np.linalg.cholesky(rims.covariance), root)
    return np.asarray(np.linalg.norm(whitened, ord=2, axis=(1, 2)) < 1.0)
