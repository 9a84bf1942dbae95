"""Brightness of the ground around a rim: patches of albedo are told from the relief beside the crest."""

import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.ellipse import normalised_chart, pixel_chart
from craternav_fg.photometry import LunarLambert
from craternav_fg.vision.edges import EdgeOptions, find_edge_points, level_around
from craternav_fg.vision.ground_level import (
    common_share,
    level_at,
    levels_of_flanks,
    own_share,
    smooth_level,
    smooth_share,
)
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.predicted_rims import PredictedRims
from craternav_fg.vision.rim_fitting import RimFitter
from tests.vision.oblique_crater import PSF_PX
from tests.vision.oblique_crater import crater as seen_crater

CAMERA = Camera(192, 192, 150.0, 150.0, 95.5, 95.5)
RADIUS_PX, REFERENCE, SLOPE_CONTRAST = 40.0, 100.0, 1.2
CENTRE = np.array([96.2, 94.7])
CHART = np.array([*CENTRE, np.log(RADIUS_PX), 0.0, np.log(RADIUS_PX)])
V, U = np.mgrid[0:192, 0:192]
ANGLE = np.arctan2(V - CENTRE[1], U - CENTRE[0])
OUTSIDE_PX = np.hypot(U - CENTRE[0], V - CENTRE[1]) - RADIUS_PX


def predicted(contrast=SLOPE_CONTRAST):
    """Rim of Lambertian ground that gets nowhere brighter."""
    # Ground that rises towards the light at +x faces away from it.
    return PredictedRims(
        np.array([0]), normalised_chart(CHART, CAMERA)[0][None], CHART[None], np.array([contrast]),
        np.array([[contrast * RADIUS_PX, 0.0]]), -0.5 * RADIUS_PX**2 * np.eye(2)[None],
        np.array([[contrast * RADIUS_PX / np.hypot(1.0, contrast), 0.0]]), np.zeros((1, 2)),
        np.array([[1.0 / np.hypot(1.0, contrast), 1.0]]), np.zeros(1), np.arctan([contrast]),
        np.array([REFERENCE]), np.zeros((1, 2)), np.zeros((1, 5, 6)),
    )  # fmt: skip


SHADING = predicted().shading(0)


def crater(albedo=1.0, contrast=SLOPE_CONTRAST):
    """Ground of slope 0.6 inside the crest and -0.2 outside it, which is rounded: brightness."""
    # The slope is zero on the crest.
    slope = 0.2 - 0.4 * np.tanh(OUTSIDE_PX / 2.0 + np.arctanh(0.5))
    light = 1.0 - contrast * np.cos(ANGLE) * slope
    return (REFERENCE * albedo * light / np.sqrt(1.0 + slope**2)).astype(np.float32)


def trace(image, ground=None, *, thorough=False):
    options = EdgeOptions(min_slope_contrast=0.4)
    return find_edge_points(
        image, CAMERA, CHART, SHADING, RADIUS_PX, 4.0, 0.0, options, ground, thorough=thorough
    )


def scatter_px(edges):
    return float(np.std(np.linalg.norm(edges.points_px - CENTRE, axis=1)))


def test_points_on_patches_of_albedo_return_to_the_crest():
    plain = trace(crater())
    patchy = trace(crater(1.0 + 0.05 * np.cos(3.0 * ANGLE + 0.5)))
    share = own_share(patchy.evidence, common_share(np.tile(patchy.evidence, (12, 1))))
    assert share > 0.65
    assert scatter_px(patchy) > 0.4
    assert scatter_px(patchy.at_level(share)) < 0.7 * scatter_px(patchy)
    assert scatter_px(plain.at_level(1.0)) < 0.12


def test_relief_beside_the_crest_is_not_taken_for_albedo():
    # Hollows and hills on the flanks alone, seven around the rim.
    beside = np.exp(-0.5 * ((np.abs(OUTSIDE_PX) - 4.5) / 1.2) ** 2)
    edges = trace(crater(1.0 + 0.15 * beside * np.cos(7.0 * ANGLE)))
    share = common_share(np.tile(edges.evidence, (12, 1)))
    assert share < 0.25
    assert scatter_px(edges.at_level(own_share(edges.evidence, share))) < 0.5 * scatter_px(
        edges.at_level(1.0)
    )


def test_a_frame_decides_for_rims_that_show_little():
    clear, empty = np.array([4.0, 4.0]), np.zeros(2)
    for sign in (1.0, -1.0):
        common = common_share(np.array([[sign * clear[0], clear[1]], empty]))
        assert own_share(empty, common) == pytest.approx(common)
        assert common > 0.9 if sign > 0.0 else common == 0.0
    assert 0.0 < common_share(np.empty((0, 2))) < 1.0


def test_a_smooth_level_is_that_of_the_ground_whatever_a_few_flanks_show():
    angles = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    contrasts = SLOPE_CONTRAST * np.cos(angles)
    # Across the illumination direction, and of the second order: what flanks can tell from their slopes.
    level = -0.1 + 0.08 * np.sin(angles) + 0.05 * np.sin(2.0 * angles)
    inner, outer = 0.4, -0.2
    slopes = np.tile([inner, outer], (60, 1))
    flanks = (1.0 + slopes * contrasts[:, None]) / np.hypot(1.0, slopes) - 1.0
    bends = flanks - slopes * contrasts[:, None]
    found = smooth_level(angles, flanks + level[:, None], contrasts, slopes, bends)
    assert [level_at(found, angle) for angle in angles] == pytest.approx(level, abs=0.02)
    # A neighbour where the light runs along the rim, where it does not touch the slopes of the flanks.
    flanks[13:17] += 0.5
    found = smooth_level(angles, flanks + level[:, None], contrasts, slopes, bends)
    assert [level_at(found, angle) for angle in angles] == pytest.approx(level, abs=0.03)
    assert not smooth_level(angles[:8], flanks[:8], contrasts[:8], slopes[:8], bends[:8]).any()


def test_crossings_that_dark_and_bright_ground_hides_are_found_at_the_level_of_the_ground():
    image = crater(1.0 + 0.2 * np.cos(2.0 * ANGLE + 0.6))
    options = EdgeOptions(min_slope_contrast=0.4)
    first = trace(image)
    level = level_around(image, CAMERA, CHART, SHADING, RADIUS_PX, options)
    second = trace(image, level)
    assert len(first) < 0.9 * first.tried
    assert len(second) > 0.95 * second.tried
    assert scatter_px(first) > 3.0 * scatter_px(second)
    mean_px = np.mean(np.linalg.norm(second.points_px - CENTRE, axis=1))
    assert mean_px == pytest.approx(RADIUS_PX, abs=0.15)


def test_edges_that_a_patch_moves_outwards_are_found_as_those_moved_inwards():
    """The outer slope is too faint to show the former; rims got too small by what is lost."""
    patches = 0.25 * np.sign(np.sin(4.0 * ANGLE))
    image = crater(1.0 + patches)

    def found(edges):
        """Edges where a patch moves them outwards and inwards, away from the borders of patches."""
        x = edges.points_px - CENTRE
        angle = np.arctan2(x[:, 1], x[:, 0])
        # The wall on the side of the light is the dark one.
        way = -np.cos(angle) * np.sin(4.0 * angle)
        clear = np.abs(np.sin(4.0 * angle)) > 0.5
        off_px = np.hypot(*x.T) - RADIUS_PX
        return off_px[clear & (way > 0.0)], off_px[clear & (way < 0.0)]

    before, _ = found(trace(image))
    outwards, inwards = found(trace(image, thorough=True).at_level(1.0))
    assert len(before) < 0.5 * len(outwards)
    assert len(outwards) > 0.9 * len(inwards)
    assert np.mean(np.concatenate([outwards, inwards])) == pytest.approx(0.0, abs=0.3)


def test_even_ground_needs_no_edges_by_flanks_alone():
    # Of the canonical crater, whose displacements are those that other traces assume of any.
    image, chart, shading = seen_crater(RADIUS_PX, 0.0, 0.6, LunarLambert(0.0, 0.0))
    camera = Camera(len(image), len(image), 1e3, 1e3, chart[0], chart[1], psf_sigma_px=PSF_PX)
    options = EdgeOptions(min_slope_contrast=0.4)
    even, lost = (
        find_edge_points(image, camera, chart, shading, RADIUS_PX, 4.0, 0.0, options, thorough=thorough)
        for thorough in (False, True)
    )
    assert len(even) == even.tried
    np.testing.assert_allclose(lost.points_px, even.points_px, atol=0.06)


def test_the_smooth_share_is_the_larger_one():
    shares = np.linspace(0.0, 1.0, 6)
    smooth = np.array([smooth_share(share) for share in shares])
    assert smooth[[0, -1]].tolist() == [0.0, 1.0]
    assert np.all(smooth[1:-1] > shares[1:-1])
    assert np.all(np.diff(smooth) > 0.0)


def test_a_rim_on_patches_is_fitted_at_the_level_of_the_ground():
    image = crater(1.0 + 0.25 * np.cos(2.0 * ANGLE + 0.6))
    rims = predicted()
    fitter = RimFitter(image, 0.0, 0.0, CAMERA, GuidedOptions())
    rough, fitted = (fitter.fit(rims, np.array([4.0]), rough=only) for only in (True, False))
    off_px = [
        np.abs(np.exp(pixel_chart(one.charts[0], CAMERA)[[2, 4]]) - RADIUS_PX).max()
        for one in (rough, fitted)
    ]
    assert off_px[1] < 0.3
    assert off_px[0] > 2.0 * off_px[1]
    assert fitted.quality.found_share[0] > rough.quality.found_share[0]


def test_flanks_of_no_crest_do_not_extrapolate_the_level():
    """Both flanks rise outward alike: the crest would lie far beyond them."""
    contrasts = np.tile([0.5, -0.5], 20)
    for inner, outer, share in ((0.5, 0.4, 0.1), (-0.4, -0.5, 0.9), (0.2, 0.2, 0.5)):
        flanks = contrasts[:, None] * np.array([inner, outer])
        slopes = np.tile([0.4, -0.2], (40, 1))
        bends = 1.0 / np.sqrt(1.0 + slopes**2) - 1.0
        level = levels_of_flanks(flanks, contrasts, slopes, bends)
        # How steep the flanks look is how bent they are.
        steepness = np.clip((inner - outer) / 0.6, 0.0, 1.0)
        low, high = (flanks - steepness**2 * bends).T[::-1]
        np.testing.assert_allclose(level, low + share * (high - low), rtol=1e-9)


def test_a_rim_is_as_uncertain_as_its_edges_move_with_the_ground():
    """On ground of the same scatter, a third of the slope contrast moves the edges three times as far."""
    sigmas_px = []
    for contrast in (SLOPE_CONTRAST, SLOPE_CONTRAST / 3.0):
        fitter = RimFitter(crater(1.0, contrast), 0.0, 0.05, CAMERA, GuidedOptions())
        fitted = fitter.fit(predicted(contrast), np.array([4.0]))
        sigmas_px.append(np.sqrt(fitted.errors.systematic[0, 0, 0]) * CAMERA.fx_px)
    assert sigmas_px[1] > 2.0 * sigmas_px[0]
    assert sigmas_px[0] > 0.01
