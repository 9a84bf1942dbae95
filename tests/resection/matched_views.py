"""Rims of simulated views, all matched, with one fault each: what a consensus must not believe."""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import axes_of_chart, chart_covariance, chart_of_axes, normalised_chart, pixel_chart
from craternav_fg.resection.problem import MatchedRims, ResectionProblem, ResectionResult
from craternav_fg.simulation.catalog_views import View, ViewOptions, random_view
from factors.kernels.gauss_newton import screw_between

EDGE_SIGMA_PX, EDGE_POINTS = 1.0, 60
# A pose of six numbers is farther from the truth, squared, once in 1e6.
FAR2 = 38.0


def draw(catalog: Catalog, rng: np.random.Generator, index: int, **options: float) -> View:
    """Draw a view of 12 to 100 true rims without noise; the fields of view alternate."""
    field_deg = (44.0, 60.0)[index % 2]
    given = ViewOptions(field_deg=field_deg, sigma_px=0.0, false=0.0, missing=0.1, **options)
    return random_view(catalog, given, rng, true_rims=(12, 100))


@dataclass(frozen=True)
class Faults:
    """Faults of image, camera, catalogue or stated noise; none by default."""

    mirrored: bool = False
    image_scale: float = 1.0
    shift_px: float | np.ndarray = 0.0
    focal_scale: float = 1.0
    size_scale: float = 1.0
    body_scale: float = 1.0
    said_sigma_px: float = EDGE_SIGMA_PX


def matched(
    catalog: Catalog, view: View, rng: np.random.Generator, faults: Faults = Faults(),
    craters: np.ndarray | None = None,
) -> ResectionProblem:  # fmt: skip
    """Return the problem of a view with edge noise and faults."""
    camera = view.camera
    true, _ = normalised_chart(chart_of_axes(view.ellipses_px), camera)
    spread = np.linalg.cholesky(chart_covariance(true, camera, EDGE_SIGMA_PX, EDGE_POINTS))
    charts = true + (spread @ rng.normal(size=(len(true), 5, 1)))[..., 0]
    ellipses = axes_of_chart(pixel_chart(charts, camera))
    if faults.mirrored:
        ellipses[:, 0] = camera.width_px - 1 - ellipses[:, 0]
        ellipses[:, 4] *= -1.0
    ellipses[:, :4] *= faults.image_scale
    ellipses[:, :2] += faults.shift_px
    said = scaled_focal(camera, faults.focal_scale)
    charts, _ = normalised_chart(chart_of_axes(ellipses), said)
    rows = view.craters if craters is None else craters
    rims = MatchedRims(
        tuple(map(str, range(len(rows)))), faults.body_scale * catalog.centres[rows],
        faults.size_scale * catalog.axes[rows],
        charts, chart_covariance(charts, said, faults.said_sigma_px, EDGE_POINTS),
    )  # fmt: skip
    return ResectionProblem(rims)


def scaled_focal(camera: Camera, scale: float) -> Camera:
    """Return a camera with other focal lengths."""
    return replace(camera, fx_px=scale * camera.fx_px, fy_px=scale * camera.fy_px)


def some_swapped(view: View, rng: np.random.Generator, share: float) -> np.ndarray:
    """Craters of a view's rims, a share of them exchanged among each other."""
    craters = view.craters.copy()
    bad = rng.permutation(len(craters))[: round(share * len(craters))]
    craters[bad] = craters[np.roll(bad, 1)]
    return craters


def is_right(result: ResectionResult, view: View) -> bool:
    """Whether the pose is within its covariance."""
    error = np.empty(6)
    screw_between(np.ascontiguousarray(result.poses[0].gTb), view.gTb, error)
    return bool(error @ np.linalg.solve(result.poses[0].covariance, error) < FAR2)
