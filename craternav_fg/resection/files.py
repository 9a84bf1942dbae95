"""Resection problems from files, and results as plain data: what the command line reads and prints."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.columns import ID
from craternav_fg.catalogs.common_shift import share_of_rims
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.importing import ImportReport
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.ellipses import MatchedEllipses, read_matched_ellipses
from craternav_fg.dataset.measurements import ground_sun_direction
from craternav_fg.ellipse import (
    axes_covariance,
    chart_of_axes,
    half_sides,
    normalised_chart,
)
from craternav_fg.measurements import KnownAttitude, SunTilt
from craternav_fg.resection.edge_fit import fit_covariance
from craternav_fg.resection.problem import (
    MatchedRims,
    PoseSolution,
    ResectionError,
    ResectionProblem,
    ResectionResult,
    Status,
)
from craternav_fg.undistortion import seen_through_lens
from factors.arrays import FloatArray

# Standard deviations of angles that are accepted.
_SIGMA_RANGE_DEG = (1e-6, 360.0)
# Of central differences, as a share of the semi-minor axis, or in rad.
_STEP = 1e-5


def read_rims(
    path: Path,
    camera: Camera,
    catalog_path: Path,
    body: Body | None,
    *,
    sigma_px: float,
    edge_points: int,
    sigma_ellipse_px: float | None = None,
) -> tuple[MatchedRims, Catalog, ImportReport]:
    """Read fitted ellipses with their craters.

    Parameters
    ----------
    path : Path
        CSV of ellipses as the image shows them, through the lens:
        ellipseCenterX(px), ellipseCenterY(px), ellipseSemimajor(px), ellipseSemiminor(px),
        ellipseRotation(deg) (of the major axis, from the image's x axis towards its y axis), CRATER_ID,
        and optionally sigma_px, the standard deviation of the rim's edge points along the rim's normal, or
        covariance, see `read_matched_ellipses`, which goes before all other sigmas. Further columns are
        ignored.
    camera : Camera
    catalog_path : Path
        Any catalogue that can be imported.
    body : Body or None
        Body of the catalogue; None for the one that the catalogue states.
    sigma_px : float
        Standard deviation of edge points for files without the column sigma_px.
    edge_points : int
        Number of edge points, all round the rim, to which each ellipse is taken to be fitted.
    sigma_ellipse_px : float, optional
        Standard deviation of each coordinate of an ellipse's centre and of each semi-axis, instead of that of
        edge points.

    Returns
    -------
    rims : MatchedRims
    catalog : Catalog
        The craters of the rims, in their order.
    report : ImportReport
        What was skipped in the catalogue, or assumed about it.

    Raises
    ------
    InputError
        When there are no rows, a value is out of range, a rim is outside the image, or a crater is given
        twice or is not in the catalogue; names file, line and column.
    """
    matched = read_matched_ellipses(path, camera)
    catalog, report = _craters(matched, catalog_path, body)
    charts_px = chart_of_axes(matched.ellipses_px)
    charts, J = _without_distortion(charts_px, camera)
    if matched.covariances is not None:
        J = J @ _axes_jacobian(matched.ellipses_px)
        covariances_px = matched.covariances
    elif sigma_ellipse_px is not None:
        covariances_px = np.array([axes_covariance(chart, sigma_ellipse_px) for chart in charts_px])
    else:
        sigmas_px = np.full(len(matched), sigma_px) if matched.sigmas_px is None else matched.sigmas_px
        covariances_px = _fit_covariances_px(charts_px, camera, sigmas_px, edge_points)
    covariances = J @ covariances_px @ np.swapaxes(J, 1, 2)
    rims = MatchedRims(catalog.identifiers, catalog.centres, catalog.axes, charts, covariances)
    return rims, catalog, report


def _without_distortion(charts_px: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Charts (n, 5) in normalised image coordinates, and Jacobians (n, 5, 5) in those seen in the image."""
    ones = np.ones(len(charts_px))
    half = half_sides(charts_px)
    # The shear is a length over the half width.
    shear = np.exp(charts_px[:, 4] - charts_px[:, 2])
    steps = _STEP * np.column_stack([half, ones, shear, ones])
    return seen_through_lens(charts_px, camera), _jacobian(
        lambda charts: seen_through_lens(charts, camera), charts_px, steps
    )


def _axes_jacobian(ellipses_px: FloatArray) -> FloatArray:
    """Jacobians (n, 5, 5) of charts in centre, semi-axes and rotation."""
    minor_px = ellipses_px[:, 3]
    steps = _STEP * np.column_stack([minor_px, minor_px, minor_px, minor_px, np.ones(len(ellipses_px))])
    return _jacobian(chart_of_axes, ellipses_px, steps)


def _jacobian(
    function: Callable[[FloatArray], FloatArray], values: FloatArray, steps: FloatArray
) -> FloatArray:
    """Jacobians (n, 5, 5) by central differences with steps (n, 5)."""
    columns = []
    for k in range(5):
        step = steps * (np.arange(5) == k)
        columns.append((function(values + step) - function(values - step)) / (2.0 * steps[:, k, None]))
    return np.stack(columns, axis=-1)


def _fit_covariances_px(
    charts_px: FloatArray, camera: Camera, sigmas_px: FloatArray, edge_points: int
) -> FloatArray:
    """Covariances (n, 5, 5) of charts fitted to edge points, px."""
    charts, scale = normalised_chart(charts_px, camera)
    covariances = [
        fit_covariance(chart, camera, float(sigma), edge_points)
        for chart, sigma in zip(charts, sigmas_px, strict=True)
    ]
    return np.asarray(np.array(covariances) / np.outer(scale, scale))


def resection_problem(
    rims: MatchedRims, catalog: Catalog, camera: Camera, *, attitude_wxyz: Sequence[float] | None,
    attitude_sigma_deg: float, sun: Sequence[float] | None,
) -> ResectionProblem:  # fmt: skip
    """Make a resection problem of a command's options.

    Parameters
    ----------
    rims : MatchedRims
    catalog : Catalog
        The craters of the rims, in their order.
    camera : Camera
    attitude_wxyz : sequence of float or None
        Quaternion of gRb, scalar first, of any length but zero.
    attitude_sigma_deg : float
        Standard deviation of the attitude about each axis; 0 takes it as exact.
    sun : sequence of float or None
        Angle of the sunward direction along the ground, from the image's x axis towards its y axis, and its
        standard deviation, deg, at the mean of the rims; then the direction towards the sun in g, three
        numbers.

    Returns
    -------
    ResectionProblem

    Raises
    ------
    ResectionError
        When a quaternion or a direction is zero, or a standard deviation is out of range.
    """
    least, most = _SIGMA_RANGE_DEG
    for name, sigma in (("attitude", attitude_sigma_deg or least), ("sun", sun[1] if sun else least)):
        if not least <= sigma <= most:
            raise ResectionError(
                f"{name}: expected a standard deviation of {least:g} to {most:g} deg, found {sigma:g}"
            )
    known = None
    if attitude_wxyz is not None:
        gRb = frames.from_quaternion_wxyz(_direction("attitude: expected a quaternion", attitude_wxyz))
        # Images compare the camera's attitude with it, which is as wrong as the mounting.
        known = KnownAttitude(gRb, math.hypot(np.radians(attitude_sigma_deg), camera.mounting_sigma_rad))
    tilt = None
    if sun is not None:
        point = rims.chart[:, :2].mean(axis=0)
        angle = np.radians(sun[0])
        # A lens, and pixels that are not square, turn directions.
        along = np.linalg.solve(camera.pixels_jacobian(point), [np.cos(angle), np.sin(angle)])
        towards = _direction("sun: expected a direction", sun[2:])
        ground = ground_sun_direction(towards, catalog, np.arange(len(catalog)), np.zeros(3))
        tilt = SunTilt(float(np.arctan2(along[1], along[0])), float(np.radians(sun[1])), point, ground)
    return ResectionProblem(rims, camera.bTc, attitude=known, sun=tilt)


def _direction(expected: str, values: Sequence[float]) -> FloatArray:
    """Return the unit vector along `values`."""
    v = np.array(values)
    largest = np.abs(v).max()
    if not largest > 0.0:
        raise ResectionError(f"{expected}, found zero")
    # Scaled first: squares of very large numbers overflow, those of very small ones vanish.
    v /= largest
    return np.asarray(v / np.linalg.norm(v))


def as_plain_data(
    problem: ResectionProblem, result: ResectionResult, catalog: Catalog, camera: Camera | None = None
) -> dict[str, Any]:
    """Convert a result to lists, numbers and texts for JSON.

    Parameters
    ----------
    problem : ResectionProblem
    result : ResectionResult
    catalog : Catalog
        The rims' craters, in their order: for altitudes, and for the shift that they have in common.
    camera : Camera, optional
        For stated errors of its mounting; without it, b is the camera.

    Returns
    -------
    dict
        Without poses unless the status is solved or ambiguous.
    """
    usable = result.status in (Status.SOLVED, Status.AMBIGUOUS)
    kept = np.array([name not in result.wrong for name in problem.rims.identifiers])
    weights = kept / problem.rims.covariance[:, [0, 1], [0, 1]].mean(axis=1)
    return {
        "status": result.status.name.lower(),
        "reason": result.reason,
        "rims": list(problem.rims.identifiers),
        "wrong": list(result.wrong),
        "warnings": list(result.warnings),
        "sigma_scale": result.sigma_scale,
        "focal_scale": _number(result.focal_scale),
        "focal_scale_sigma": _number(result.focal_scale_sigma),
        "poses": [_pose(problem, pose, catalog, weights, camera) for pose in result.poses] if usable else [],
    }


def _number(value: float) -> float | None:
    """None for a number that JSON cannot carry."""
    return value if np.isfinite(value) else None


def _pose(
    problem: ResectionProblem,
    pose: PoseSolution,
    catalog: Catalog,
    weights: FloatArray,
    camera: Camera | None,
) -> dict[str, Any]:
    """Return one solution as plain data; the weights (n,) of the rims are 0 for those that were rejected."""
    gP = pose.gTb[:3, 3]
    share = 1.0
    if problem.attitude is not None:
        share = share_of_rims(pose.covariance[:3, :3], problem.attitude.sigma_rad**2 * np.eye(3))
    elif problem.prior is not None:
        share = share_of_rims(pose.covariance[:3, :3], problem.prior.covariance[:3, :3])
    of_map = catalog.image_covariance(pose.gTb, weights, share)
    # As in a run's files: positions in g.
    of_b = pose.covariance
    if camera is not None:
        of_b = of_b + camera.mounting_covariance(share)
    covariance = frames.rotate_position_block(of_b, pose.gTb[:3, :3]) + of_map
    latitude, longitude = frames.latitude_longitude(gP)
    return {
        "probability": pose.probability,
        "squared_norm": pose.cost,
        "position_m": gP.tolist(),
        "attitude_wxyz": frames.to_quaternion_wxyz(pose.gTb[:3, :3]).tolist(),
        "latitude_deg": float(np.degrees(latitude)),
        "longitude_deg": float(np.degrees(longitude)),
        "altitude_m": float(catalog.body.altitude_m(gP)),
        "covariance": covariance.tolist(),
        "position_sigma_m": np.sqrt(np.diag(covariance)[3:]).tolist(),
        "attitude_sigma_deg": np.degrees(np.sqrt(np.diag(covariance)[:3])).tolist(),
        "residuals": dict(zip(problem.rims.identifiers, pose.residuals.tolist(), strict=True)),
    }


def _craters(matched: MatchedEllipses, path: Path, body: Body | None) -> tuple[Catalog, ImportReport]:
    """Find the craters of the rims in the catalogue."""
    catalog, report = import_catalog(path, body)
    known = {identifier: row for row, identifier in enumerate(catalog.identifiers)}
    reasons = {row.identifier: f"line {row.line}: {row.reason}" for row in report.skipped}
    for k, identifier in enumerate(matched.craters):
        if identifier not in known:
            why = f" ({reasons[identifier]})" if identifier in reasons else ""
            matched.table.fail(k, ID, f"expected a crater of {path}, found {identifier!r}{why}")
    return catalog.take(np.array([known[identifier] for identifier in matched.craters])), report
