"""Views with one fault each of image, camera, body or catalogue."""

from dataclasses import dataclass, replace

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import axes_of_chart, chart_covariance, chart_of_axes, normalised_chart, pixel_chart
from craternav_fg.simulation.catalog_views import View, ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.scenes import MOON

EDGE_SIGMA_PX, EDGE_POINTS = 1.0, 60
FAULTS = (
    "mirrored", "shuffled", "scattered", "half-size image", "other camera", "scaled craters", "other body",
    "other catalogue",
)  # fmt: skip
# Mars's radius over the Moon's, half the focal length again, twice the size.
_BODY_SCALE, _FOCAL_SCALE, _SIZE_SCALE = 1.95, 1.5, 2.0


@dataclass(frozen=True)
class Given:
    """What a search is given of a view: ellipses, px, the camera as it is said to be, and the true pose."""

    ellipses_px: np.ndarray
    camera: Camera
    view: View

    def normalised(self) -> tuple[np.ndarray, np.ndarray]:
        """Charts (n, 5) and covariances (n, 5, 5) in normalised image coordinates."""
        charts, _ = normalised_chart(chart_of_axes(self.ellipses_px), self.camera)
        return charts, chart_covariance(charts, self.camera, EDGE_SIGMA_PX, EDGE_POINTS)


def draw(catalog: Catalog, rng: np.random.Generator, fault: str | None, **options: object) -> Given:
    """Draw a view of 12 to 100 rims, a fifth of them false, with the noise of their edges and a fault."""
    given = ViewOptions(
        **{"field_deg": float(rng.choice([44.0, 60.0])), "sigma_px": 0.0, "missing": 0.1, **options}
    )
    view = random_view(catalog, given, rng, true_rims=(12, 100))
    true, _ = normalised_chart(chart_of_axes(view.ellipses_px), view.camera)
    spread = np.linalg.cholesky(chart_covariance(true, view.camera, EDGE_SIGMA_PX, EDGE_POINTS))
    charts = true + (spread @ rng.normal(size=(len(true), 5, 1)))[..., 0]
    ellipses, camera = axes_of_chart(pixel_chart(charts, view.camera)), view.camera
    if fault == "mirrored":
        ellipses[:, 0] = camera.width_px - 1 - ellipses[:, 0]
        ellipses[:, 4] *= -1.0
    elif fault == "shuffled":
        order = rng.permutation(len(ellipses))
        ellipses[order, :2] = ellipses[np.roll(order, 1), :2]
    elif fault == "scattered":
        ellipses[:, :2] = rng.uniform(0.0, camera.width_px - 1, (len(ellipses), 2))
    elif fault == "half-size image":
        ellipses[:, :4] *= 0.5
    elif fault == "other camera":
        camera = replace(camera, fx_px=_FOCAL_SCALE * camera.fx_px, fy_px=_FOCAL_SCALE * camera.fy_px)
    return Given(ellipses, camera, view)


def searched(catalog: Catalog, fault: str | None) -> Catalog:
    """Return the catalogue that is searched for views of another."""
    if fault == "other catalogue":
        return synthetic_catalog(MOON, np.random.default_rng(1))
    if fault == "other body":
        return replace(catalog, body=replace(MOON, name="other", radius_m=_BODY_SCALE * MOON.radius_m))
    if fault == "scaled craters":
        return replace(
            catalog, semi_major_m=_SIZE_SCALE * catalog.semi_major_m,
            semi_minor_m=_SIZE_SCALE * catalog.semi_minor_m,
        )  # fmt: skip
    return catalog
