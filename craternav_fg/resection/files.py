"""A static problem from files, and its answer as plain data: what the command line reads and prints."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.columns import ID
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.importing import ImportReport
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.ellipses import MatchedEllipses, read_matched_ellipses
from craternav_fg.dataset.measurements import ground_sun_direction
from craternav_fg.ellipse import chart_of_axes, normalised_chart
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

FloatArray = npt.NDArray[np.float64]

# Of an angle's standard deviation.
_SIGMA_RANGE_DEG = (1e-6, 360.0)


def read_rims(
    path: Path, camera: Camera, catalog_path: Path, body: Body | None, *, sigma_px: float, edge_points: int
) -> tuple[MatchedRims, Catalog, ImportReport]:
    """Read fitted ellipses with the craters they are matched to.

    Parameters
    ----------
    path : Path
        CSV: ellipseCenterX(px), ellipseCenterY(px), ellipseSemimajor(px), ellipseSemiminor(px),
        ellipseRotation(deg) (of the major axis, from the image's x axis towards its y axis), CRATER_ID,
        and optionally sigma_px, the standard deviation of the rim's edge points along the rim's normal.
        Further columns are not read.
    camera : Camera
    catalog_path : Path
        Catalogue of any origin.
    body : Body or None
        Which it must be of; None for the one that it tells.
    sigma_px : float
        For files without that column.
    edge_points : int
        Points all round the rim that an ellipse is taken to rest on.

    Returns
    -------
    rims : MatchedRims
    catalog : Catalog
        The craters of the rims, in their order.
    report : ImportReport
        What was left out of the whole catalogue, or taken for granted.

    Raises
    ------
    InputError
        Naming file, line and column: no rows, a value out of range, a rim outside the image, a crater
        twice or not in the catalogue.
    """
    matched = read_matched_ellipses(path, camera)
    catalog, report = _craters(matched, catalog_path, body)
    sigmas = np.full(len(matched), sigma_px) if matched.sigmas_px is None else matched.sigmas_px
    charts, _ = normalised_chart(chart_of_axes(matched.ellipses_px), camera)
    covariances = np.array(
        [
            fit_covariance(chart, camera, float(sigma), edge_points)
            for chart, sigma in zip(charts, sigmas, strict=True)
        ]
    )
    rims = MatchedRims(catalog.identifiers, catalog.centres, catalog.axes, charts, covariances)
    return rims, catalog, report


def resection_problem(
    rims: MatchedRims, catalog: Catalog, camera: Camera, *, attitude_wxyz: Sequence[float] | None,
    attitude_sigma_deg: float, sun: Sequence[float] | None,
) -> ResectionProblem:  # fmt: skip
    """Put together what a command was given.

    Parameters
    ----------
    rims, catalog
        From `read_rims`.
    camera : Camera
    attitude_wxyz : sequence of float or None
        Quaternion of gRb; its length does not matter.
    attitude_sigma_deg : float
    sun : sequence of float or None
        Tilt of the light on the ground amid the rims and its standard deviation, deg; direction to the
        sun in g.

    Raises
    ------
    ResectionError
        For a quaternion or a direction of no length, and a standard deviation out of range.
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
        known = KnownAttitude(gRb, float(np.radians(attitude_sigma_deg)))
    tilt = None
    if sun is not None:
        towards = _direction("sun: expected a direction", sun[2:])
        ground = ground_sun_direction(towards, catalog, np.arange(len(catalog)), np.zeros(3))
        tilt = SunTilt(
            float(np.radians(sun[0])), float(np.radians(sun[1])), rims.chart[:, :2].mean(axis=0), ground
        )
    return ResectionProblem(rims, camera.bTc, attitude=known, sun=tilt)


def _direction(expected: str, values: Sequence[float]) -> FloatArray:
    """Give the unit vector along `values`, of whatever length."""
    v = np.array(values)
    largest = np.abs(v).max()
    if not largest > 0.0:
        raise ResectionError(f"{expected}, found zero")
    # First to about one: the squares of large and small numbers overflow.
    v /= largest
    return np.asarray(v / np.linalg.norm(v))


def as_plain_data(problem: ResectionProblem, result: ResectionResult, body: Body) -> dict[str, Any]:
    """Give a result as lists, numbers and texts: what JSON can carry.

    Poses are those to be used: none of a problem that is not determined, whatever samples there are.
    """
    usable = result.status in (Status.SOLVED, Status.AMBIGUOUS)
    return {
        "status": result.status.name.lower(),
        "reason": result.reason,
        "rims": list(problem.rims.identifiers),
        "wrong": list(result.wrong),
        "warnings": list(result.warnings),
        "poses": [_pose(problem, pose, body) for pose in result.poses] if usable else [],
    }


def _pose(problem: ResectionProblem, pose: PoseSolution, body: Body) -> dict[str, Any]:
    gP = pose.gTb[:3, 3]
    latitude, longitude = frames.latitude_longitude(gP)
    return {
        "probability": pose.probability,
        "squared_norm": pose.cost,
        "position_m": gP.tolist(),
        "attitude_wxyz": frames.to_quaternion_wxyz(pose.gTb[:3, :3]).tolist(),
        "latitude_deg": float(np.degrees(latitude)),
        "longitude_deg": float(np.degrees(longitude)),
        "altitude_m": float(body.altitude_m(gP)),
        "covariance": pose.covariance.tolist(),
        "position_sigma_m": np.sqrt(np.diag(pose.position_covariance)).tolist(),
        "attitude_sigma_deg": np.degrees(np.sqrt(np.diag(pose.covariance)[:3])).tolist(),
        "residuals": dict(zip(problem.rims.identifiers, pose.residuals.tolist(), strict=True)),
    }


def _craters(matched: MatchedEllipses, path: Path, body: Body | None) -> tuple[Catalog, ImportReport]:
    """Look up the craters of the rims."""
    catalog, report = import_catalog(path, body)
    known = {identifier: row for row, identifier in enumerate(catalog.identifiers)}
    reasons = {row.identifier: f"line {row.line}: {row.reason}" for row in report.skipped}
    for k, identifier in enumerate(matched.craters):
        if identifier not in known:
            why = f" ({reasons[identifier]})" if identifier in reasons else ""
            matched.table.fail(k, ID, f"expected a crater of {path}, found {identifier!r}{why}")
    return catalog.take(np.array([known[identifier] for identifier in matched.craters])), report
