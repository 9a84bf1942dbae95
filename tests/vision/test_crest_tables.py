"""Rim crests seen obliquely lie where they are, under any photometric law."""

import numpy as np
import pytest

from craternav_fg.photometry import LunarLambert
from craternav_fg.simulation.crater_shape import crater_profile
from craternav_fg.vision import crater_profile as canonical
from craternav_fg.vision.crest_tables import LIFTS, SLOPE_CONTRASTS, crest_tables, crossing_parts
from craternav_fg.vision.edges import EdgeOptions
from tests.vision.oblique_crater import PSF_PX, crater, cross_section, errors_px

OPTIONS = EdgeOptions()
# Edges across which less contrast shows have little weight, and crossings far beyond the crest.
_FAINT = 0.4
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


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("emission_deg", [0.0, 25.0])
@pytest.mark.parametrize("steepness", [0.5, 1.0, 1.6])
def test_a_shallow_or_steep_crater_is_as_large_and_where_it_is(steepness, emission_deg, share):
    """Taken for the canonical one, the steep one was displaced by 0.03 to 0.13 px, and 0.24 px small.

    With the crossings of Lambertian ground all were up to 0.06 px small on Lommel-Seeliger ground.
    """
    rho, slope, height = cross_section()
    every = []
    for azimuth_deg in (20.0, 60.0, 120.0, 160.0):
        section = rho, steepness * slope, steepness * height
        view = np.deg2rad(emission_deg), np.deg2rad(azimuth_deg)
        image, chart, shading = crater(28.0, *view, LunarLambert(share, 0.0), section)
        every.append(errors_px(image, chart, shading))
    assert np.abs(np.array(every)[:, 0]).max() < 0.04
    assert np.abs(np.array(every)[:, 1:]).max() < 0.03


def test_sharp_crests_seen_obliquely_are_not_displaced():
    """With flanks lifted as those of the canonical crater they were 0.05 px nearer the camera."""
    rho, *_ = cross_section()
    every = []
    for crest in (0.015, 0.06):
        height = np.array([crater_profile(r, 0.4, 0.09, crest) for r in rho])
        top = rho[np.argmax(height)]
        height = np.array([crater_profile(r * top, 0.4, 0.09, crest) for r in rho]) / top
        section = rho, np.gradient(height, rho), height - np.interp(1.0, rho, height)
        for share in (0.0, 1.0):
            for azimuth_deg in (20.0, 60.0, 120.0, 160.0):
                view = np.deg2rad(25.0), np.deg2rad(azimuth_deg)
                image, chart, shading = crater(28.0, *view, LunarLambert(share, 0.0), section)
                every.append(errors_px(image, chart, shading))
    assert abs(np.mean(every, axis=0)[0]) < 0.03


@pytest.mark.parametrize(("steepness", "limit"), [(0.5, 0.3e-3), (1.0, 0.6e-3)])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_crossings_are_those_of_the_photometric_law(share, steepness, limit):
    """Those of Lambertian ground were off by 1e-3 to 4e-3 of the radius under other laws or steepness."""
    blur = 0.06
    slope = steepness * canonical.seen_ground(0.0)[2]

    def brightness(slopes, elevation, emission, towards_sun, towards_camera):
        length = np.hypot(1.0, slopes)
        mu0 = np.maximum(np.sin(elevation) - slopes * np.cos(elevation) * towards_sun, 0.0) / length
        mu = (np.cos(emission) - slopes * np.sin(emission) * towards_camera) / length
        return share * 2.0 * mu0 / (mu0 + mu) + (1.0 - share) * mu0

    off, emission, h = [], np.deg2rad(20.0), 1e-4
    for elevation in np.deg2rad([25.0, 40.0, 60.0]):
        for towards in ((0.9, 0.0), (-0.9, 0.0), (0.6, 0.8), (-0.6, 0.8), (0.6, -0.8)):
            of_view = elevation, emission, *towards
            flat, up, down = brightness(np.array([0.0, h, -h]), *of_view)
            contrast, bend = (up - down) / (2.0 * h * flat), (up + down - 2.0 * flat) / (2.0 * h * h * flat)
            if abs(contrast) < _FAINT:
                continue
            excess = np.sign(contrast) * (brightness(slope, *of_view) / flat - 1.0)
            true = canonical.crossing(canonical.blurred(excess, np.array([blur]))[0], 1.0) - 1.0
            odd, bent, _ = crossing_parts(TABLES, -0.5 * contrast / bend, 0.0, blur, steepness, share)
            off.append(odd + bent - true)
    assert np.sqrt(np.mean(np.square(off))) < limit


def test_parts_of_a_crossing_are_those_of_a_scaled_crater():
    """As the canonical crater's, what the second order does would be wrong by a quarter of it or more."""
    blur = 0.06

    def crossing(contrast, lift, steepness):
        _, _, slope = canonical.seen_ground(lift * steepness)
        excess = np.sign(contrast) * canonical.excess_brightness(steepness * slope, contrast)
        return canonical.crossing(canonical.blurred(excess, np.array([blur]))[0], 1.0) - 1.0

    found, expected, former = [], [], []
    for steepness in (0.6, 1.5, 2.0):
        for contrast in (0.5, 0.8, 1.2, 2.0):
            true = [crossing(c, 0.0, steepness) for c in (contrast, -contrast)]
            expected.append(0.5 * (true[0] - true[1]))
            parts = crossing_parts(TABLES, contrast, 0.4, blur, steepness, 0.0)
            found.append(parts[1])
            former.append(crossing_parts(TABLES, contrast, 0.4, blur, 1.0, 0.0)[1])
            # Lifted ground is displaced towards the camera, by a tenth of a per cent or two.
            lifted = crossing(contrast, 0.4, steepness) - true[0]
            assert parts[2] == pytest.approx(lifted, abs=1.2e-3 if contrast > 0.5 else 3e-3)
    found, expected, former = map(np.array, (found, expected, former))
    assert np.sqrt(np.mean((found - expected) ** 2)) < 1.2e-3
    assert np.sqrt(np.mean((former - expected) ** 2)) > 4e-3
