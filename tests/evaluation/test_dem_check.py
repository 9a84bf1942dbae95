"""Correlation with a shaded elevation model, on ground that the test invents."""

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.evaluation.dem_check import check_against_dem, correlate, shaded

RADIUS = 1737400.0
rasterio = pytest.importorskip("rasterio")


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    """Rough ground of 8 x 8 deg around (0, 0), 64 points a degree."""
    rng = np.random.default_rng(1)
    n = 512
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.fftfreq(n)))
    k[0, 0] = 1.0
    heights = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) * k**-1.6).real
    heights = 1200.0 * heights / heights.std()
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    crs = f"+proj=longlat +R={RADIUS:.0f} +no_defs"
    transform = rasterio.Affine(8.0 / n, 0.0, -4.0, 0.0, -8.0 / n, 4.0)
    with rasterio.open(
        path, "w", driver="GTiff", width=n, height=n, count=1, dtype="float32", crs=crs, transform=transform
    ) as raster:
        raster.write(heights.astype(np.float32), 1)
    return read_dem(path, 1.0, RADIUS)


CAMERA = Camera(256, 256, 256.0, 256.0, 127.5, 127.5)
SUN = np.array([0.45, 0.89, 0.1]) / np.linalg.norm([0.45, 0.89, 0.1])
# Above (0, 0), the camera's z down, 110 km up.
POSE = frames.pose(
    np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([RADIUS + 110e3, 0, 0])
)


def test_flat_ground_is_as_bright_everywhere_as_its_slope_says(dem):
    image = shaded(CAMERA, POSE, SUN, dem, RADIUS, 4)
    assert image.shape == (64, 64)
    assert np.isfinite(image).all()
    assert image.std() > 0.05
    # Turned by half a turn about the axis, the camera sees the image turned.
    turned = POSE.copy()
    turned[:3, :3] = POSE[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(shaded(CAMERA, turned, SUN, dem, RADIUS, 4), image[::-1, ::-1], atol=1e-9)


def test_the_altitude_and_the_shift_of_the_true_pose_are_found(dem):
    light = shaded(CAMERA, POSE, SUN, dem, RADIUS, 1)
    rng = np.random.default_rng(2)
    image = np.clip(120.0 * light + 2.0 * rng.standard_normal(light.shape), 0, 255).astype(np.uint8)
    wrong = POSE.copy()
    wrong[0, 3] += 900.0
    wrong[:3, :3] = POSE[:3, :3] @ frames.rotation_exp([0.01, -0.006, 0.002])
    found = check_against_dem(image, CAMERA, wrong, SUN, dem, RADIUS, step_px=2)
    assert found.best > 0.93
    assert found.best > found.correlation + 0.1
    assert found.altitude_m == pytest.approx(-900.0, abs=100.0)
    # A turn about x moves the image along y, one about -y along x.
    np.testing.assert_allclose(found.shift_px, [-0.006 * 256.0, -0.01 * 256.0], atol=0.4)
    right = check_against_dem(image, CAMERA, POSE, SUN, dem, RADIUS, step_px=2)
    assert right.best - right.correlation < 0.01
    assert abs(right.altitude_m) < 100.0


def test_correlation_ignores_what_changes_slowly():
    rng = np.random.default_rng(3)
    detail = rng.standard_normal((80, 80))
    slow = 6.0 * np.add.outer(np.linspace(0.0, 1.0, 80) ** 2, np.linspace(0.0, 1.0, 80))
    assert correlate(detail, 3.0 * detail + slow) > 0.95
    assert abs(correlate(detail, rng.standard_normal((80, 80)))) < 0.1
    assert correlate(detail, np.zeros((80, 80))) == 0.0
    holes = detail.copy()
    holes[:10] = np.nan
    assert correlate(detail, holes) == pytest.approx(1.0, abs=0.02)


class Bump:
    """Stands for an elevation model: a plain 5 km above the sphere, with a hill at a place (3,) on it."""

    step_rad = 1e-4

    def __init__(self, place, hill_m):
        self.place, self.hill_m = place, hill_m

    def heights_m(self, directions):
        away_m = RADIUS * np.linalg.norm(directions - self.place, axis=1)
        return 5e3 + self.hill_m * np.exp(-0.5 * (away_m / 900.0) ** 2)


def test_a_hill_is_seen_where_it_stands_and_lit_from_the_sun():
    camera = Camera(200, 120, 256.0, 256.0, 99.5, 59.5)
    pose = frames.pose(POSE[:3, :3] @ frames.rotation_exp(np.array([0.5, 0.2, 0.0])), POSE[:3, 3])
    pixel = np.array([[131.0, 71.0]])
    ray = pose[:3, :3] @ [*camera.normalised(pixel)[0], 1.0]
    ray /= np.linalg.norm(ray)
    # Where the ray meets the plain, a sphere.
    down = -(ray @ pose[:3, 3])
    far = down - np.sqrt(down**2 - pose[:3, 3] @ pose[:3, 3] + (RADIUS + 5e3) ** 2)
    place = pose[:3, 3] + far * ray
    place /= np.linalg.norm(place)
    for step_px in (1, 2):
        hill, plain = (shaded(camera, pose, SUN, Bump(place, h), RADIUS, step_px) for h in (150.0, 0.0))
        change = hill - plain
        assert change.shape == (120 // step_px, 200 // step_px)
        weight = np.abs(change) / np.abs(change).sum()
        y, x = (step_px * axis + 0.5 * (step_px - 1) for axis in np.indices(change.shape))
        assert [(weight * x).sum(), (weight * y).sum()] == pytest.approx(pixel[0], abs=1.0)
        # Brighter on the side of the sun.
        bright, dark = (
            np.array([(part * x).sum(), (part * y).sum()]) / part.sum()
            for part in (np.maximum(change, 0.0), np.maximum(-change, 0.0))
        )
        to_sun = pose[:3, :3].T @ SUN
        assert (bright - dark) @ to_sun[:2] > 0.9 * np.linalg.norm(bright - dark) * np.linalg.norm(to_sun[:2])
