"""The direction towards the sun in an image, from pose and sun."""

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.photometry import flat_terrain_brightness
from craternav_fg.sun_in_image import sun_angle_in_image

RADIUS_M = 1737400.0
CAMERA = Camera(1024, 1024, 1000.0, 1000.0, 511.5, 511.5)


def looking_down(rng: np.random.Generator, tilt_deg: float) -> np.ndarray:
    """Pose of a camera 80 km above the origin of longitudes, with a random roll and direction of its tilt."""
    roll, toward = rng.uniform(0.0, 2.0 * np.pi, 2)
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    tilt = np.deg2rad(tilt_deg) * np.array([np.cos(toward), np.sin(toward), 0.0])
    gRc = down @ frames.rotation_exp(tilt) @ frames.rotation_exp(np.array([0.0, 0.0, roll]))
    return frames.pose(gRc, np.array([RADIUS_M + 80e3, 0.0, 0.0]))


@pytest.mark.parametrize("tilt_deg", [0.0, 25.0])
def test_facets_that_are_tilted_away_from_it_are_darkest(tilt_deg: float) -> None:
    rng = np.random.default_rng(3)
    turns = np.linspace(0.0, 2.0 * np.pi, 3600, endpoint=False)
    for _ in range(20):
        gTc = looking_down(rng, tilt_deg)
        elevation, azimuth = rng.uniform(0.2, 1.2), rng.uniform(0.0, 2.0 * np.pi)
        sun = np.array(
            [np.sin(elevation), *(np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)]))]
        )
        found = sun_angle_in_image(CAMERA, gTc, sun, RADIUS_M)
        assert found is not None
        # Facets of the ground at the image's centre, each rising in another direction, and their brightness.
        sight = gTc[:3, 2]
        ahead = -(sight @ gTc[:3, 3])
        middle = gTc[:3, 3] + sight * (ahead - np.sqrt(RADIUS_M**2 - gTc[:3, 3] @ gTc[:3, 3] + ahead**2))
        up = middle / np.linalg.norm(middle)
        east = np.cross([0.0, 0.0, 1.0], up) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], up))
        rising = np.outer(np.cos(turns), east) + np.outer(np.sin(turns), np.cross(up, east))
        normals = up - 1e-4 * rising
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        view = np.broadcast_to(-sight, normals.shape)
        darkest = rising[np.argmin(flat_terrain_brightness(normals, sun, view)[0])]
        ends = np.array([middle, middle + 100.0 * darkest])
        begin, end = CAMERA.project((ends - gTc[:3, 3]) @ gTc[:3, :3])
        expected = np.arctan2(end[1] - begin[1], end[0] - begin[0])
        assert abs(np.angle(np.exp(1j * (found - expected)))) < np.deg2rad(0.5)


def test_none_without_ground_or_sun_at_the_centre() -> None:
    gTc = looking_down(np.random.default_rng(1), 0.0)
    assert sun_angle_in_image(CAMERA, gTc, np.array([-1.0, 0.0, 0.0]), RADIUS_M) is None
    away = gTc.copy()
    away[:3, :3] = gTc[:3, :3] @ frames.rotation_exp(np.array([0.5 * np.pi, 0.0, 0.0]))
    assert sun_angle_in_image(CAMERA, away, np.array([1.0, 0.0, 0.0]), RADIUS_M) is None
