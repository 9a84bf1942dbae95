import cv2
import numpy as np
import pytest

from craternav_fg.vision.sun import SunOptions, _axis, measure_sun_tilt
from craternav_fg.vision.wall_shading import sun_azimuth_offset
from tests.vision import scene


def error_deg(measured, gTb):
    """Measured tilt less that of its direction, seen from the true pose at the image centre."""
    x, y, _ = gTb[:3, :3].T @ measured.direction
    return np.rad2deg(np.angle(np.exp(1j * (measured.tilt_rad - np.arctan2(y, x)))))


def picture(elevation_deg=35.0, azimuth_deg=40.0, heading_rad=0.3, tilt_deg=0.0, seed=1):
    rng = np.random.default_rng(seed)
    gTb, sun_g = scene.pose(heading_rad, tilt_deg), scene.sun(elevation_deg, azimuth_deg)
    catalog = scene.craters(rng, 12)
    return gTb, sun_g, scene.render(catalog, gTb, sun_g, rng, roughness=0.03)


@pytest.mark.parametrize(
    ("elevation_deg", "azimuth_deg", "heading_rad", "tilt_deg"),
    [(12.0, 10.0, 0.3, 0.0), (30.0, 130.0, 2.0, 0.0), (55.0, 250.0, 4.0, 0.0), (30.0, 60.0, 1.0, 20.0)],
)
def test_tilt_within_its_sigma(elevation_deg, azimuth_deg, heading_rad, tilt_deg):
    gTb, sun_g, image = picture(elevation_deg, azimuth_deg, heading_rad, tilt_deg)
    measured = measure_sun_tilt(image, scene.camera(), scene.MOON, gTb, sun_g)
    assert measured is not None
    assert abs(error_deg(measured, gTb)) < 3.0 * np.rad2deg(measured.sigma_rad)
    assert np.rad2deg(measured.sigma_rad) < 6.0


def test_direction_is_along_the_ground_below_the_image_centre():
    gTb, sun_g, image = picture(tilt_deg=20.0)
    measured = measure_sun_tilt(image, scene.camera(), scene.MOON, gTb, sun_g)
    assert measured is not None
    np.testing.assert_array_equal(measured.point, [0.0, 0.0])
    # The tilted camera looks at the site.
    assert abs(measured.direction @ scene.SITE[:, 2]) < 1e-6
    across = np.cross(sun_g, scene.SITE[:, 2])
    assert abs(measured.direction @ across) < 1e-6
    assert measured.direction @ sun_g > 0.0


@pytest.mark.parametrize("turn_deg", [-40.0, 25.0, 60.0])
def test_a_wrong_heading_of_the_prediction_does_not_enter(turn_deg):
    gTb, sun_g, image = picture(seed=2)
    wrong = scene.moved(gTb, [0.0, 0.0, np.deg2rad(turn_deg)])
    measured = measure_sun_tilt(image, scene.camera(), scene.MOON, wrong, sun_g)
    assert measured is not None
    assert abs(error_deg(measured, gTb)) < 8.0


def test_sigma_grows_with_obliqueness_attitude_and_faint_shading():
    camera = scene.camera()
    gTb, sun_g, image = picture()
    straight = measure_sun_tilt(image, camera, scene.MOON, gTb, sun_g)
    unsure = measure_sun_tilt(image, camera, scene.MOON, gTb, sun_g, attitude_sigma_rad=0.2)
    pose, sun_oblique, oblique_image = picture(tilt_deg=30.0)
    oblique = measure_sun_tilt(oblique_image, camera, scene.MOON, pose, sun_oblique)
    faint = 100.0 + 0.04 * (image - 110.0) + np.random.default_rng(0).normal(0.0, 2.0, image.shape)
    noisy_image = np.clip(faint, 0, 255).astype(np.uint8)
    noisy = measure_sun_tilt(noisy_image, camera, scene.MOON, gTb, sun_g)
    assert straight is not None
    assert unsure is not None
    assert oblique is not None
    assert unsure.sigma_rad > 2.0 * straight.sigma_rad
    assert oblique.sigma_rad > 1.5 * straight.sigma_rad
    assert noisy is None or noisy.sigma_rad > 2.0 * straight.sigma_rad


def test_undefined_without_shading():
    camera = scene.camera()
    gTb, sun_g, image = picture()
    zenith = scene.SITE[:, 2]
    assert measure_sun_tilt(image, camera, scene.MOON, gTb, zenith) is None
    assert measure_sun_tilt(image, camera, scene.MOON, gTb, -sun_g) is None
    assert measure_sun_tilt(np.full_like(image, 90), camera, scene.MOON, gTb, sun_g) is None
    away = scene.moved(gTb, [np.pi, 0.0, 0.0])
    assert measure_sun_tilt(image, camera, scene.MOON, away, sun_g) is None


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0])
def test_craters_show_the_sun_far_better_than_the_relief(tilt_deg):
    """Elliptical bowls on rough ground, any illumination direction.

    The scene reflects by Lambert's law, not as the Moon: seen obliquely that turns the shading by degrees,
    all alike, and the standard deviation must allow for it.
    """
    errors, chi2 = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        azimuth_deg, heading_rad = rng.uniform(0.0, 360.0), rng.uniform(0.0, 6.28)
        gTb, sun_g = scene.pose(heading_rad, tilt_deg), scene.sun(25.0 + 4.0 * seed, azimuth_deg)
        catalog = scene.craters(rng, 10, half=0.25)
        image = scene.render(catalog, gTb, sun_g, rng, roughness=0.03)
        measured = measure_sun_tilt(image, scene.camera(), scene.MOON, gTb, sun_g, craters=catalog)
        assert measured is not None
        errors.append(error_deg(measured, gTb))
        chi2.append((errors[-1] / np.rad2deg(measured.sigma_rad)) ** 2)
    assert np.sqrt(np.mean(np.square(errors))) < (1.0 if tilt_deg == 0.0 else 9.0)
    assert np.mean(chi2) < 4.5


def test_craters_show_the_sense_of_the_sun_direction():
    """The image is lit from elsewhere than the given sun: three craters suffice to show it."""
    gTb, sun_g = scene.pose(), scene.sun(30.0, 40.0)
    rng = np.random.default_rng(3)
    catalog = scene.craters(rng, 3)
    image = scene.render(catalog, gTb, scene.sun(30.0, 200.0), rng)
    measured = measure_sun_tilt(image, scene.camera(), scene.MOON, gTb, sun_g, craters=catalog)
    assert measured is not None
    off = np.angle(np.exp(1j * np.deg2rad(error_deg(measured, gTb))))
    # The camera looks down: angles about the ground's normal run the other way in the image.
    assert abs(abs(np.rad2deg(off)) - 160.0) < 8.0


def test_a_sense_that_a_known_attitude_contradicts_is_no_measurement():
    gTb, _, image = picture()
    opposite = scene.sun(35.0, 220.0)
    assert measure_sun_tilt(image, scene.camera(), scene.MOON, gTb, opposite) is None
    unknown = measure_sun_tilt(image, scene.camera(), scene.MOON, gTb, opposite, attitude_sigma_rad=0.7)
    assert unknown is None or abs(abs(error_deg(unknown, gTb)) - 180.0) < 20.0


def test_the_axis_of_blocks_is_as_sure_as_their_scatter():
    """Blocks of one elongation whose axes scatter by 0.15 rad about one at 0.4 rad."""
    rng = np.random.default_rng(5)
    squares, offsets = [], []
    for _ in range(200):
        angle = 0.4 + 0.15 * rng.standard_normal(50)
        axis = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        tensors = 0.6 * axis[:, :, None] * axis[:, None, :] + 0.2 * np.eye(2)
        units = -0.3 * axis + 0.1 * rng.standard_normal((50, 2))
        offset, sigma, sense = _axis(tensors, units, SunOptions())
        assert sense == 1.0
        assert _axis(tensors, -units, SunOptions())[2] == -1.0
        assert _axis(tensors, 0.1 * rng.standard_normal((50, 2)), SunOptions(min_anisotropy=0.7))[1] == np.inf
        offsets.append(offset)
        squares.append(((offset - 0.4) / sigma) ** 2)
    assert np.mean(offsets) == pytest.approx(0.4, abs=6e-3)
    assert 0.7 < np.mean(squares) < 1.35


def test_noise_has_no_sun():
    camera, gTb, sun_g = scene.camera(), scene.pose(), scene.sun()
    for seed, blur_px in enumerate([0.0, 0.0, 1.0, 2.0, 4.0, 8.0]):
        noise = np.random.default_rng(seed).normal(size=(scene.SIZE_PX, scene.SIZE_PX))
        if blur_px:
            noise = cv2.GaussianBlur(noise, (0, 0), blur_px)
        image = np.clip(110.0 + 6.0 * noise / noise.std(), 0, 255).astype(np.uint8)
        assert measure_sun_tilt(image, camera, scene.MOON, gTb, sun_g) is None


@pytest.mark.parametrize(("azimuth_deg", "told"), [(270.0, False), (315.0, False), (180.0, True)])
def test_walls_tell_no_sun_that_hangs_on_the_photometric_law(azimuth_deg, told):
    """With it behind the camera, Lambertian walls showed it 50 deg off, to 11 and 20 deg."""
    rng = np.random.default_rng(1)
    catalog, gTb, sun_g = scene.craters(rng, 10), scene.pose(0.5, 30.0), scene.sun(65.0, azimuth_deg)
    image = scene.render(catalog, gTb, sun_g, rng).astype(np.float32)
    offset_rad, sigma_rad = sun_azimuth_offset(image, scene.camera(), catalog, gTb, sun_g)
    assert np.isfinite(sigma_rad) == told
    assert np.isfinite(offset_rad) == told
