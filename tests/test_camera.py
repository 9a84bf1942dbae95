from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from craternav_fg.camera import Camera

# EuRoC's cam0, and one that bends the other way, tilted, with a third radial term.
BARREL = (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0)
PINCUSHION = (0.15, 0.05, -0.004, 0.006, 0.02)
PINHOLE = Camera(752, 480, 458.654, 457.296, 367.215, 248.375)
LENSES = [BARREL, PINCUSHION]
# A rational lens as OpenCV calibrates wide ones, and a fisheye: TUM VI's cam0, scaled to this image.
RATIONAL = (0.3, -0.05, 3e-4, -2e-4, 0.004, 0.45, -0.04, 0.006)
FISHEYE = (0.0034, 0.0007, -0.002, 0.0002)
WIDE = {
    "rational": replace(PINHOLE, distortion=RATIONAL, lens_model="rational"),
    "fisheye": replace(PINHOLE, fx_px=300.0, fy_px=301.0, distortion=FISHEYE, lens_model="fisheye"),
}


def corners(camera: Camera) -> np.ndarray:
    x, y = camera.width_px - 0.5, camera.height_px - 0.5
    return np.array([[-0.5, -0.5], [x, -0.5], [-0.5, y], [x, y]])


@pytest.mark.parametrize("distortion", LENSES)
def test_pixels_are_opencvs(distortion):
    camera = replace(PINHOLE, distortion=distortion)
    rng = np.random.default_rng(1)
    px = rng.uniform(0.0, [751.0, 479.0], (300, 2))
    u = camera.normalised(px)
    # Its own undistortion stops far from convergence; its distortion is exact.
    theirs, _ = cv2.projectPoints(
        np.column_stack([u, np.ones(len(u))]), np.zeros(3), np.zeros(3), camera.matrix, np.array(distortion)
    )
    np.testing.assert_allclose(theirs[:, 0], px, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(camera.pixels(u), px, rtol=0.0, atol=1e-9)
    assert np.abs(camera.pinhole.pixels(u) - px).max() > 20.0


def theirs_px(camera: Camera, u: np.ndarray) -> np.ndarray:
    """Project by OpenCV."""
    k = np.array(camera.distortion)
    if camera.lens_model == "fisheye":
        return cv2.fisheye.distortPoints(u[:, None], camera.matrix, k)[:, 0]
    points = np.column_stack([u, np.ones(len(u))])
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, k)[0][:, 0]


@pytest.mark.parametrize("model", WIDE)
def test_wide_lenses_are_opencvs(model):
    camera = WIDE[model]
    px = np.random.default_rng(4).uniform(-0.4, [751.4, 479.4], (300, 2))
    u = camera.normalised(px)
    np.testing.assert_allclose(theirs_px(camera, u), px, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(camera.pixels(u), px, rtol=0.0, atol=1e-8)
    assert np.abs(camera.pinhole.pixels(u) - px).max() > 20.0


@pytest.mark.parametrize("model", WIDE)
@pytest.mark.parametrize("spread", [1e-5, 0.5, 6.0])
def test_jacobian_of_wide_lenses(model, spread):
    camera = WIDE[model]
    u = np.random.default_rng(2).uniform(-spread, spread, (200, 2))
    h = 1e-6
    numeric = np.stack(
        [(camera.pixels(u + h * e) - camera.pixels(u - h * e)) / (2.0 * h) for e in np.eye(2)], axis=-1
    )
    away = np.abs(np.linalg.norm(u, axis=1) - camera.lens[-1]) > 1e-5
    np.testing.assert_allclose(camera.pixels_jacobian(u)[away], numeric[away], rtol=1e-5, atol=1e-4)


def test_a_fisheye_sees_far_from_its_axis_but_not_behind_it():
    camera = replace(PINHOLE, fx_px=300.0, fy_px=300.0, distortion=(0.0,) * 4, lens_model="fisheye")
    corner = camera.normalised(np.array([-0.5, -0.5]))
    assert np.degrees(np.arctan(np.linalg.norm(corner))) == pytest.approx(
        np.degrees(np.hypot(367.715, 248.875) / 300.0), abs=1e-9
    )
    for factor in (1.05, 4.0, 100.0):
        assert not camera.contains(camera.pixels(factor * corner), -0.4)
    with pytest.raises(ValueError, match="90 deg from its axis"):
        replace(camera, fx_px=200.0, fy_px=200.0)


def test_a_lens_with_other_coefficients_is_refused():
    with pytest.raises(ValueError, match="8 coefficients of a rational lens, found 5"):
        replace(PINHOLE, lens_model="rational")
    with pytest.raises(ValueError, match="found 'polynomial'"):
        replace(PINHOLE, lens_model="polynomial")


@pytest.mark.parametrize("distortion", LENSES)
@pytest.mark.parametrize("spread", [0.5, 4.0])
def test_jacobian(distortion, spread):
    """Inside the image, and far beyond it, where the polynomials are not used any more."""
    camera = replace(PINHOLE, distortion=distortion)
    u = np.random.default_rng(2).uniform(-spread, spread, (200, 2))
    h = 1e-6
    numeric = np.stack(
        [(camera.pixels(u + h * e) - camera.pixels(u - h * e)) / (2.0 * h) for e in np.eye(2)], axis=-1
    )
    # Its derivative jumps at the reach alone.
    away = np.abs(np.linalg.norm(u, axis=1) - camera.lens[-1]) > 1e-5
    np.testing.assert_allclose(camera.pixels_jacobian(u)[away], numeric[away], rtol=1e-5, atol=1e-4)


@settings(deadline=None, max_examples=60)
# Nearly flat half-way to the corners.
@example((0.0, -0.203125, 0.0, 0.0, 0.0625), 0.5)
@given(
    st.tuples(*[st.floats(-0.4, 0.4)] * 2, *[st.floats(-0.02, 0.02)] * 2, st.floats(-0.1, 0.1)),
    st.floats(0.4, 3.0),
)
def test_every_lens_is_inverted_or_refused(distortion, focal):
    """No direction beyond the image seems to lie in it."""
    try:
        camera = Camera(200, 150, 200.0 * focal, 200.0 * focal, 95.0, 80.0, np.eye(4), distortion)
    except ValueError:
        return
    px = np.stack(np.meshgrid(np.linspace(-0.5, 199.5, 21), np.linspace(-0.5, 149.5, 21)), axis=-1)
    u = camera.normalised(px)
    np.testing.assert_allclose(camera.pixels(u), px, rtol=0.0, atol=1e-8)
    edge = np.concatenate([u[0], u[-1], u[:, 0], u[:, -1]])
    for factor in (1.05, 1.5, 4.0, 30.0):
        assert not np.any(camera.contains(camera.pixels(factor * edge), -0.4))


def test_a_distortion_that_folds_is_refused():
    # r (1 - r^2) turns back at r = 0.58: inside the corners, outside the middle of the sides.
    with pytest.raises(ValueError, match="folds inside the image"):
        replace(PINHOLE, distortion=(-1.0, 0.0, 0.0, 0.0, 0.0))
    replace(PINHOLE, fx_px=1500.0, fy_px=1500.0, distortion=(-1.0, 0.0, 0.0, 0.0, 0.0))


def test_without_distortion_nothing_changes():
    px = np.random.default_rng(3).uniform(0.0, 400.0, (5, 4, 2))
    u = PINHOLE.normalised(px)
    assert PINHOLE.pinhole is PINHOLE
    np.testing.assert_array_equal(u, (px - [PINHOLE.cx_px, PINHOLE.cy_px]) / [PINHOLE.fx_px, PINHOLE.fy_px])
    np.testing.assert_allclose(PINHOLE.pixels(u), px, atol=1e-10)
    np.testing.assert_array_equal(PINHOLE.pixels_jacobian(u)[2, 3], np.diag([458.654, 457.296]))


def test_the_corners_of_a_distorted_image_see_less_or_more():
    seen = [
        np.linalg.norm(camera.normalised(corners(camera)), axis=1).mean()
        for camera in (replace(PINHOLE, distortion=BARREL), PINHOLE, replace(PINHOLE, distortion=PINCUSHION))
    ]
    assert seen[0] > seen[1] > seen[2]


def test_border_points_run_along_all_four_sides():
    camera = Camera(5, 3, 10.0, 10.0, 2.0, 1.0)
    upper, lower, left, right = camera.border_px(2, 0.5).reshape(4, 2, 2).tolist()
    assert upper == [[0.5, 0.5], [3.5, 0.5]]
    assert lower == [[0.5, 1.5], [3.5, 1.5]]
    assert left == [[0.5, 0.5], [0.5, 1.5]]
    assert right == [[3.5, 0.5], [3.5, 1.5]]
