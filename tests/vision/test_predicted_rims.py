import numpy as np

from craternav_fg.body import ground_points
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.vision.guided import GuidedFrontEnd
from craternav_fg.vision.predicted_rims import predict_rims
from craternav_fg.vision.reference_brightness import ReferenceBrightness
from factors.arrays import FloatArray
from tests.vision import scene

CAMERA = scene.camera()


def seen(elevation_deg: float, falloff: float, seed: int = 6) -> tuple:
    """Scene seen off nadir, whose brightness falls away from the middle of the image, and its image."""
    rng = np.random.default_rng(seed)
    catalog, gTb, sun_g = scene.craters(rng), scene.pose(0.5, 20.0), scene.sun(elevation_deg, 60.0)
    image = scene.render(catalog, gTb, sun_g, rng).astype(np.float32)
    line = np.linspace(-1.0, 1.0, scene.SIZE_PX)
    image *= 1.0 - falloff * (line[:, None] ** 2 + line**2) / 2.0
    return catalog, gTb, sun_g, image


def brightness_of(image: FloatArray, gTb: FloatArray, sun_g: FloatArray) -> ReferenceBrightness:
    return ReferenceBrightness(image, CAMERA, scene.MOON.radius_m, gTb, sun_g)


def test_the_gradient_is_that_of_the_reference_from_rim_to_rim() -> None:
    """Reference brightnesses of the same craters, moved by a little."""
    catalog, gTb, sun_g, image = seen(40.0, 0.4)
    brightness = brightness_of(image, gTb, sun_g)
    rows = np.arange(len(catalog))
    rims = predict_rims(rows, CAMERA, catalog, gTb, sun_g, brightness)
    assert len(rims) == len(rows)
    centre_px = rims.charts_px[:, :2]
    for axis in (0, 1):
        ahead, behind = (_reference_at(centre_px + d * np.eye(2)[axis], brightness, gTb, sun_g)
                         for d in (5.0, -5.0))  # fmt: skip
        slope = (ahead - behind) / (10.0 * rims.reference)
        np.testing.assert_allclose(rims.gradient[:, axis], slope, atol=2e-4)
    assert np.abs(rims.gradient).max() > 1e-3


def _reference_at(
    points_px: FloatArray, brightness: ReferenceBrightness, gTb: FloatArray, sun_g: FloatArray
) -> FloatArray:

    points = CAMERA.normalised(points_px)
    gTc = CAMERA.gTc(gTb)
    ground, hit = ground_points(gTc[:3, :3], gTc[:3, 3], points, scene.MOON.radius_m)
    assert hit.all()
    view = gTc[:3, 3] - ground
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    law, _ = flat_terrain_brightness(ground / scene.MOON.radius_m, sun_g, view)
    return law * brightness.ratio(points)


def test_the_curvature_is_that_of_the_ground_along_the_image() -> None:
    """On a level rim seen from above all directions of the ground have the image's lengths."""
    catalog, gTb, sun_g, image = seen(40.0, 0.0)
    rims = predict_rims(
        np.arange(len(catalog)), CAMERA, catalog, gTb, sun_g, brightness_of(image, gTb, sun_g)
    )
    for K in rims.curvature_px:
        np.testing.assert_allclose(K, K.T, rtol=1e-9)
        # Slopes of ground as far from the zenith of the sun as this make it darker, whichever way they face.
        assert np.all(np.linalg.eigvalsh(K) < 0.0)
    radius_px = np.exp(0.5 * (rims.charts_px[:, 2] + rims.charts_px[:, 4]))
    shares = np.linalg.eigvalsh(rims.curvature_px) / radius_px[:, None] ** 2
    assert np.all((shares > -1.0) & (shares < -0.05))


def test_sizes_do_not_depend_on_where_a_lens_is_darker() -> None:
    """Brightness that grows across a rim moves its edges outwards on both sides, or inwards."""
    slopes = []
    for falloff in (0.0, 0.6):
        towards_sun, larger = [], []
        for seed in (6, 7):
            catalog, gTb, sun_g, image = seen(60.0, falloff, seed)
            image = image.clip(0.0, 255.0).astype(np.uint8)
            rims = GuidedFrontEnd(CAMERA, catalog).measure(
                image, 0, gTb, scene.covariance(0.5), sun_g
            ).rims  # fmt: skip
            true = scene.true_charts(catalog, gTb, rims.craters)
            along = CAMERA.gTc(gTb)[:3, :2].T @ sun_g
            towards_sun.append(true[:, :2] @ along / np.linalg.norm(along))
            larger.append(0.5 * (rims.chart[:, [2, 4]] - true[:, [2, 4]]).sum(axis=1))
        slopes.append(np.polyfit(np.concatenate(towards_sun), np.concatenate(larger), 1)[0])
    assert abs(slopes[1] - slopes[0]) < 0.01
