"""Evidence of a pose from the image's shading: where craters are too worn to be detected."""

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.shading import log_shading
from craternav_fg.matching.identify.view import view_of
from craternav_fg.simulation.catalog_views import ViewOptions, random_view
from craternav_fg.vision.shading_maps import NO_SHADING, shading_maps
from tests.vision.test_shading_maps import rough_ground, with_bowls


@pytest.fixture(scope="module")
def scene(synthetic):
    """Few of many visible craters are found."""
    options = ViewOptions(altitudes_m=(300e3, 400e3), missing=0.85, false=0.3, largest_tilt_deg=10.0)
    return random_view(synthetic.catalog, options, np.random.default_rng(8), true_rims=(5, 5))


@pytest.fixture(scope="module")
def maps(synthetic, scene):
    _, charts = synthetic.catalog.visible(scene.camera, scene.gTb, min_semi_minor_px=5.0)
    ellipses = axes_of_chart(pixel_chart(charts, scene.camera))
    assert len(ellipses) > 30
    circles = np.column_stack([ellipses[:, :2], np.sqrt(ellipses[:, 2] * ellipses[:, 3])])
    shape = scene.camera.height_px, scene.camera.width_px
    return shading_maps(with_bowls(rough_ground(np.random.default_rng(4), shape), circles, 30.0))


@pytest.fixture(scope="module")
def log_ratio(synthetic, scene):
    """Evidence with some rims matched, by default all true ones."""
    view = view_of(scene.ellipses_px, scene.camera)
    N = np.diag([1e7, 1e7, 1e7, 1e-5, 1e-5, 1e-5])

    def of(gTc, maps, match=scene.craters):
        return log_shading(view, synthetic.catalog.index, synthetic.craters, gTc, match, N, maps)

    return of


def elsewhere(gTc, rng):
    return frames.pose(frames.rotation_exp(rng.normal(size=3)), np.zeros(3)) @ gTc


def test_the_right_pose_and_others(scene, maps, log_ratio) -> None:
    """The mean of the ratio over other poses is at most 1; what the image does not show costs little."""
    assert log_ratio(scene.gTb, maps) > 20.0
    rng = np.random.default_rng(5)
    others = np.array([log_ratio(elsewhere(scene.gTb, rng), maps) for _ in range(300)])
    assert np.exp(others).mean() <= 1.0
    assert others.min() >= -np.log(4.0) - 1e-9
    assert log_ratio(scene.gTb, NO_SHADING) == 0.0


def test_rims_that_were_matched_do_not_count_again(synthetic, scene, maps, log_ratio) -> None:
    """They are in the evidence of the rims; nor do craters at the same place."""
    one = np.where(np.arange(len(scene.craters)) == np.flatnonzero(scene.craters >= 0)[0], scene.craters, -1)
    assert log_ratio(scene.gTb, maps) < log_ratio(scene.gTb, maps, one) - 3.0


def test_an_uncertain_pose_says_less(synthetic, scene, maps) -> None:
    view = view_of(scene.ellipses_px, scene.camera)
    values = [
        log_shading(
            view, synthetic.catalog.index, synthetic.craters, scene.gTb, scene.craters,
            np.diag([1e7, 1e7, 1e7, 1e-5, 1e-5, 1e-5]) / spread**2, maps,
        )
        for spread in (1.0, 10.0, 1e3)
    ]  # fmt: skip
    assert values[0] > values[1] + 3.0 > 3.0
    assert values[2] == pytest.approx(0.0)


def test_worn_craters_decide(synthetic, scene, maps) -> None:
    """The rims alone do not suffice; nor do the maps of another image, or rims of another place."""
    ellipses = scene.ellipses_px
    assert not identify(ellipses, scene.camera, synthetic).identified
    found = identify(ellipses, scene.camera, synthetic, maps=maps)
    assert found.identified
    assert scene.agrees(found.rows)
    shape = scene.camera.height_px, scene.camera.width_px
    other = shading_maps(rough_ground(np.random.default_rng(6), shape).astype(np.float32))
    assert not identify(ellipses, scene.camera, synthetic, maps=other).identified
    assert not identify(scene.mirrored(), scene.camera, synthetic, maps=maps).identified
