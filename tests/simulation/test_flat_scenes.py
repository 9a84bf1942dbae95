"""Flat scenes of the paper: craters whole in the image, apart, and of the sizes asked for."""

import numpy as np
import pytest

from craternav_fg.ellipse import pixel_chart, points_and_normals
from craternav_fg.errors import CraternavError
from craternav_fg.simulation.flat_scenes import CAMERA, inside, random_scene, random_triple


@pytest.mark.parametrize("seed", range(4))
def test_craters_lie_apart_and_whole_in_the_image(seed: int) -> None:
    scene = random_scene(np.random.default_rng(seed), 3, 10e3)
    for chart in scene.charts:
        points, _ = points_and_normals(pixel_chart(chart, CAMERA), np.linspace(0.0, 2.0 * np.pi, 200))
        assert points.min() > -1.0
        assert points.max() < 1024.0
    t = np.linspace(0.0, 2.0 * np.pi, 60)[:, None]
    rims = [c + np.cos(t) * a[0] + np.sin(t) * a[1] for c, a in zip(scene.centres, scene.axes, strict=True)]
    for k, rim in enumerate(rims):
        for c, a in zip(scene.centres[:k], scene.axes[:k], strict=True):
            x = np.stack([(rim - c) @ axis / (axis @ axis) for axis in a])
            assert (np.sum(x**2, axis=0) > 1.0).all()
    assert -scene.gTc[2, 2] > np.cos(np.deg2rad(30.001))
    sizes = np.linalg.norm(scene.axes, axis=2)
    assert (sizes[:, 0] >= sizes[:, 1]).all()
    assert sizes.min() >= 500.0
    assert sizes.max() <= 2500.0


def test_no_room_is_said() -> None:
    with pytest.raises(CraternavError, match="no room for 30 craters"):
        random_scene(np.random.default_rng(0), 30, 3e3)


def test_triples_are_in_the_image_even_from_five_radii() -> None:
    scene = random_triple(np.random.default_rng(0), 5.0, np.deg2rad(5.0))
    assert inside(scene.charts).all()
    np.testing.assert_allclose(np.linalg.norm(scene.axes, axis=2), 1.0)
