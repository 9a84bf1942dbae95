"""Rims far off nadir, badly measured: the covariance describes the errors, or a warning says it may not."""

import numpy as np
import pytest
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import (
    axes_covariance,
    axes_of_chart,
    chart_of_axes,
    normalised_chart,
    pixel_chart,
)
from craternav_fg.resection.problem import MatchedRims, ResectionProblem
from craternav_fg.resection.robust import solve_all
from craternav_fg.simulation.catalog_views import square_camera, synthetic_catalog
from craternav_fg.simulation.scenes import MOON
from factors.kernels.gauss_newton import screw_between

LEAST_PX, TILTS_DEG = 5.0, (50.0, 64.0)


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return synthetic_catalog(MOON, np.random.default_rng(0))


def slanted_pose(rng: np.random.Generator) -> np.ndarray:
    """Draw a pose at 100 to 300 km that looks towards the horizon."""
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    aside = np.cross(up, rng.normal(size=3))
    aside /= np.linalg.norm(aside)
    tilt = np.radians(rng.uniform(*TILTS_DEG))
    forward = -np.cos(tilt) * up + np.sin(tilt) * aside
    x = np.cross(forward, up)
    x /= np.linalg.norm(x)
    return frames.pose(
        np.stack([x, np.cross(forward, x), forward], axis=-1), (MOON.radius_m + rng.uniform(1e5, 3e5)) * up
    )


def measured(ellipses_px: np.ndarray, sigma_px: float, rng: np.random.Generator) -> np.ndarray:
    """Charts, px, of ellipses whose centres and axes have errors, which also turn them."""
    out = []
    for x, y, a, b, angle in ellipses_px:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        one, other, both = sigma_px * rng.normal(size=3) / [1.0, 1.0, np.sqrt(2.0)]
        root = turn @ np.diag([a, b]) @ turn.T + np.array([[one, both], [both, other]])
        axes, directions = np.linalg.eigh(root)
        minor, major = np.maximum(axes, 0.5)
        x, y = np.array([x, y]) + sigma_px * rng.normal(size=2)
        out.append([x, y, major, minor, np.arctan2(directions[1, 1], directions[0, 1])])
    return chart_of_axes(np.array(out))


def errors(
    catalog: Catalog, rims: tuple[int, int], sigma_px: float, count: int = 50
) -> tuple[np.ndarray, np.ndarray]:
    """Squared normalised errors of poses, and which of them have no warning."""
    rng = np.random.default_rng(40)
    camera = square_camera(44.0)
    squared, silent = [], []
    while len(squared) < count:
        gTb = slanted_pose(rng)
        rows, charts = catalog.visible(camera, gTb, min_semi_minor_px=LEAST_PX)
        if len(rows) < rims[0]:
            continue
        chosen = rng.permutation(len(rows))[: rims[1]]
        found_px = measured(axes_of_chart(pixel_chart(charts[chosen], camera)), sigma_px, rng)
        found, scale = normalised_chart(found_px, camera)
        covariance = np.array([axes_covariance(one, sigma_px) for one in found_px]) * np.outer(scale, scale)
        rows = rows[chosen]
        matched = MatchedRims(
            tuple(map(str, rows)), catalog.centres[rows], catalog.axes[rows], found, covariance
        )
        result = solve_all(ResectionProblem(matched))
        if result.poses:
            error = np.empty(6)
            screw_between(np.ascontiguousarray(result.poses[0].gTb), gTb, error)
            squared.append(error @ np.linalg.solve(result.poses[0].covariance, error))
            silent.append(not result.warnings)
    return np.array(squared), np.array(silent)


@pytest.mark.parametrize("rims", [(3, 4), (8, 30)])
def test_errors_are_as_the_covariance_says(catalog: Catalog, rims: tuple[int, int]) -> None:
    """Half as wide as long, 5 px and more, with errors of 6 px: three rims then give wrong poses as well."""
    squared, silent = errors(catalog, rims, 6.0)
    assert silent.sum() >= 25
    low, high = chi2.ppf([0.001, 0.999], 6 * silent.sum()) / silent.sum()
    assert low < squared[silent].mean() < high
    far2 = chi2.ppf(1.0 - 1e-5, 6)
    assert squared[silent].max() < far2
    assert (squared.max() > far2) == (rims == (3, 4))
