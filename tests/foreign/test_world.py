"""The second world itself: its IMU log explains its motion, its crests are where its images show them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent
from craternav_fg.pipeline.reconstruct import reconstruct
from tests.foreign.files import write
from tests.foreign.profiles import FAMILIES, draw_profile
from tests.foreign.rim_errors import errors_from_truth
from tests.foreign.worlds import draw_world


@pytest.mark.parametrize("family", FAMILIES)
def test_profiles_have_their_crest_at_one_radius(family: str) -> None:
    rng = np.random.default_rng(1)
    for wear in (0.0, 0.5, 1.0):
        profile = draw_profile(rng, family, wear)
        rho = np.linspace(0.0, 2.0, 2001)
        height = profile(rho)
        near = rho > 0.7
        assert rho[near][np.argmax(height[near])] == pytest.approx(1.0, abs=5e-3)
        assert height[0] < height[near].max() - 0.1
        assert profile(np.array([10.0])) == 0.0


@pytest.mark.parametrize("family", FAMILIES)
def test_a_profile_has_its_crest_at_one_radius_once_a_map_blurred_it(family: str) -> None:
    profile = draw_profile(np.random.default_rng(1), family, 0.0, blur=0.03)
    rho = np.arange(0.5, 1.5, 0.001)
    crest = rho[np.argmax(gaussian_filter1d(profile(rho), 30.0))]
    assert crest == pytest.approx(1.0, abs=2e-3)
    # It moves outward, as the wall is steeper than the outer slope.
    assert rho[np.argmax(profile(rho))] < 0.995


def test_rims_and_motion_agree_with_the_data_set(tmp_path: Path) -> None:
    world = draw_world(3, "gentle", frames=4)
    data = Dataset.open(write(world, tmp_path / "d", 3))
    assert data.truth is not None
    found = errors_from_truth(world, data, np.repeat([1e-3, 5.0], 3)).summary()
    assert found["rims"] > 20
    assert found["centre_px"] < 0.4
    assert abs(found["size_bias_percent"]) < 3.0
    exact = data.truth
    initial = Descent.of(data).initial
    alone = reconstruct(data, ["dead_reckoning"]).trajectories["dead_reckoning"]
    # From a state with the stated errors, the log leads along the true path for a minute.
    off_m = np.linalg.norm(alone.gTb[:, :3, 3] - exact.gTb[:, :3, 3], axis=1)
    assert off_m[0] < 4.0 * np.sqrt(3.0) * initial.position_sigma_m
    assert off_m[-1] < off_m[0] + 4.0 * 60.0 * np.sqrt(3.0) * initial.velocity_sigma_m_s + 60.0
