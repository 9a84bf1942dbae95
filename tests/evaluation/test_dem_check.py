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
