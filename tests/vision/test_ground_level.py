"""Brightness of the ground around a rim: patches of albedo are told from the relief beside the crest."""

import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.vision.edges import EdgeOptions, find_edge_points
from craternav_fg.vision.ground_level import common_share, own_share

CAMERA = Camera(192, 192, 150.0, 150.0, 95.5, 95.5)
RADIUS_PX, REFERENCE, SLOPE_CONTRAST = 40.0, 100.0, 1.2
CENTRE = np.array([96.2, 94.7])
CHART = np.array([*CENTRE, np.log(RADIUS_PX), 0.0, np.log(RADIUS_PX)])
V, U = np.mgrid[0:192, 0:192]
ANGLE = np.arctan2(V - CENTRE[1], U - CENTRE[0])
OUTSIDE_PX = np.hypot(U - CENTRE[0], V - CENTRE[1]) - RADIUS_PX


def crater(albedo=1.0):
    """Ground of slope 0.6 inside the crest and -0.2 outside it, which is rounded: brightness."""
    # The slope is zero on the crest.
    slope = 0.2 - 0.4 * np.tanh(OUTSIDE_PX / 2.0 + np.arctanh(0.5))
    light = 1.0 - SLOPE_CONTRAST * np.cos(ANGLE) * slope
    return (REFERENCE * albedo * light / np.sqrt(1.0 + slope**2)).astype(np.float32)


def trace(image):
    # Slope contrast per pixel of radius; ground that rises towards the light at +x faces away from it.
    contrast_px = np.array([SLOPE_CONTRAST * RADIUS_PX, 0.0])
    return find_edge_points(
        image, CAMERA, CHART, contrast_px, REFERENCE, RADIUS_PX, 4.0, 0.0, EdgeOptions(min_slope_contrast=0.4)
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
