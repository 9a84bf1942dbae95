"""Rim crests seen obliquely lie where they are, under any photometric law."""

import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.photometry import LunarLambert
from craternav_fg.vision.crest_tables import LIFTS, SLOPE_CONTRASTS, crest_tables
from craternav_fg.vision.edges import EdgeOptions, find_edge_points
from craternav_fg.vision.ground_level import own_share, smooth_share
from tests.vision.oblique_crater import PSF_PX, crater, cross_section

OPTIONS = EdgeOptions()
TABLES = crest_tables(PSF_PX, OPTIONS.smoothing_px, OPTIONS.smoothing_share)


@pytest.mark.parametrize("contrast", [-2.0, 1.5])
@pytest.mark.parametrize("blur", [0.05, 0.1])
@pytest.mark.parametrize("lift", [-1.2, -0.4, 0.0, 0.6, 1.4])
def test_crossings_against_a_blurred_crater(contrast, blur, lift):
    """Follow each ray to the ground that it meets first, blur, look for the brightness of flat terrain."""
    rho, slope, height = cross_section()
    rho, slope, height = (
        np.concatenate([sign * a[::-1], a]) for a, sign in ((rho, -1.0), (slope, -1.0), (height, 1.0))
    )
    light = np.maximum((1.0 + contrast * slope) / np.sqrt(1.0 + slope**2), 0.0)
    image = rho + lift * height
    places = np.arange(0.2, 1.9, 0.005)
    seen = np.empty(len(places))
    for i, place in enumerate(places):
        met = np.flatnonzero((image[:-1] - place) * (image[1:] - place) <= 0.0)
        # From outside, ground far from the centre comes first.
        j = met[-1] if lift < 0.0 else met[0]
        seen[i] = light[j]
    x = np.linspace(0.8, 1.25, 451)
    weight = np.exp(-0.5 * ((x[:, None] - places) / blur) ** 2)
    excess = np.sign(contrast) * (weight @ seen / weight.sum(axis=1) - 1.0)
    falls = np.flatnonzero((excess[:-1] > 0.0) & (excess[1:] <= 0.0))
    crossing = x[falls[np.argmin(np.abs(x[falls] - 1.0))]]
    j, k = int(np.argmin(np.abs(SLOPE_CONTRASTS - contrast))), int(np.argmin(np.abs(LIFTS - lift)))
    assert (SLOPE_CONTRASTS[j], LIFTS[k]) == pytest.approx((contrast, lift))
    found = np.interp(blur, TABLES.blurs, TABLES.crossings[:, j, k])
    assert found == pytest.approx(crossing - 1.0, abs=0.004)


def errors_px(image, chart, shading):
    """Shift of the rim along the ground towards the camera, and growth along and across that direction."""
    size, radius_px, flat = len(image), np.exp(chart[2]), np.exp(chart[4] - chart[2])
    camera = Camera(size, size, 1e3, 1e3, chart[0], chart[0], psf_sigma_px=PSF_PX)
    edges = find_edge_points(
        image, camera, chart, shading, radius_px * flat, 3.0, 0.0, OPTIONS, by_flanks=True
    )
    assert len(edges) > 0.8 * edges.tried > 30
    points = edges.at_level(smooth_share(own_share(edges.evidence, 0.6))).points_px - chart[:2]
    angle = np.arctan2(points[:, 1] / flat, points[:, 0])
    c, s = np.cos(angle), np.sin(angle)
    normal = np.column_stack([flat * c, s]) / np.hypot(flat * c, s)[:, None]
    on_rim = radius_px * np.column_stack([c, flat * s])
    off = np.sum((points - on_rim) * normal, axis=1)
    x, y = normal.T
    A = np.stack([flat * y, x, flat * y * s, x * c, x * s], axis=-1) / edges.sigma_ratio[:, None]
    found = np.linalg.lstsq(A, off / edges.sigma_ratio, rcond=None)[0]
    return found[[0, 2, 3]]


@pytest.mark.parametrize("law", [LunarLambert(), LunarLambert(0.8, 0.0), LunarLambert(0.1, 0.0)])
@pytest.mark.parametrize("emission_deg", [25.0, 50.0])
def test_a_rim_seen_obliquely_lies_where_it_is(emission_deg, law):
    """As if seen from above, but for the shading, it would be 0.1 px farther from the camera."""
    every = []
    for azimuth_deg in (20.0, 60.0, 120.0, 160.0):
        image, chart, shading = crater(28.0, np.deg2rad(emission_deg), np.deg2rad(azimuth_deg), law)
        every.append(errors_px(image, chart, shading))
    assert abs(np.mean(every, axis=0)[0]) < 0.03
    assert np.abs(every).max() < 0.11
