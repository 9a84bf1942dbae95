"""Rims are as large as they are, whether their crests are sharper or rounder than the canonical one."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from craternav_fg.photometry import LunarLambert
from craternav_fg.vision.crest_asymmetry import DISPLACEMENT, bluntness, displacement_share
from craternav_fg.vision.normal_profile import crossing_between
from tests.vision.oblique_crater import crater, errors_px

STEP = 1e-3
SHARP, CANONICAL, ROUND = 0.02, 0.06, 0.11


def worn_cone(wear):
    """Bowl and apron that meet in an edge, rounded by diffusion; the crest is at 1."""
    rho = np.arange(0.5, 4.0 / STEP) * STEP
    height = np.where(rho < 1.0, 0.3 * rho**2 - 0.3, 0.08 * np.maximum(rho, 1.0) ** -3.0 - 0.08)
    height = gaussian_filter1d(np.concatenate([height[::-1], height]), wear / STEP, mode="nearest")[
        len(rho) :
    ]
    i = int(np.argmax(height))
    before, here, after = height[i - 1 : i + 2]
    crest = rho[i] + 0.5 * STEP * (before - after) / (before - 2.0 * here + after)
    rho, height = rho / crest, height / crest
    return rho, np.gradient(height, rho), height - np.interp(1.0, rho, height)


@pytest.mark.parametrize(("wear", "limit_px"), [(SHARP, 0.06), (CANONICAL, 0.03), (ROUND, 0.03)])
@pytest.mark.parametrize("radius_px", [18.0, 30.0])
def test_a_rim_is_as_large_as_it_is(wear, limit_px, radius_px):
    """In proportion to the bluntness sharp crests came out 0.08 to 0.10 px too large."""
    growths = []
    for azimuth_deg in (30.0, 150.0):
        image, chart, shading = crater(
            radius_px, np.deg2rad(20.0), np.deg2rad(azimuth_deg), LunarLambert(), worn_cone(wear)
        )
        growths.append(errors_px(image, chart, shading)[1:])
    assert abs(np.mean(growths)) < limit_px


def test_the_bluntness_compares_motions():
    expected, none = np.array([0.2, 0.3, 0.25]), np.zeros(3)
    contrasts = np.array([1.0, -1.5, 5.0])
    # All but the prior, which is the canonical crater's; and the edge that jumped does not count.
    found = bluntness(np.array([0.1, 0.15, 9.0]), expected, none, contrasts)
    weight = 0.2**2 + 1.5**2 * 0.3**2
    assert found == pytest.approx((0.1 + 0.5 * weight) / (0.1 + weight))
    # What the second order of the slope and the lift do is not the asymmetry's.
    others = np.array([0.05, -0.05, 0.0])
    assert bluntness(expected + others, expected, others, contrasts) == pytest.approx(1.0)


def test_displacements_grow_with_bluntness_and_narrowness():
    assert displacement_share(0.0, 1.0) == 0.0
    assert displacement_share(1.0, 1.0) == pytest.approx(DISPLACEMENT[0] + DISPLACEMENT[1])
    shares = [displacement_share(b, 1.2) for b in (0.3, 0.6, 0.9, 1.2, 1.5)]
    assert (np.diff(np.diff(shares)) > 0.0).all()
    assert displacement_share(0.8, 1.5) > displacement_share(0.8, 1.0) > displacement_share(0.8, 0.7)
    # Nothing that is measured makes it boundless.
    assert displacement_share(40.0, 1e9) == displacement_share(2.0, 3.0)
    assert displacement_share(-40.0, 0.0) == displacement_share(-0.5, 0.6)


@pytest.mark.parametrize("place", [0.2, 0.4, 0.6, 0.8])
def test_a_crossing_between_samples_of_a_curved_profile(place):
    before, here, after, beyond = np.expm1(-0.8 * (np.arange(-1.0, 3.0) - place)).tolist()
    assert crossing_between(before, here, after, beyond) == pytest.approx(place, abs=0.02)
    assert here / (here - after) > place + 0.05
