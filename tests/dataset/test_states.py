"""Truth that looks like a failed estimator is refused: units, frames and velocities."""

import numpy as np
import pytest

from craternav_fg.body import Body
from craternav_fg.dataset import layout
from craternav_fg.dataset.states import read_states
from craternav_fg.errors import InputError
from craternav_fg.tables import write_table

CERES = Body("Ceres", 470e3, 6.26e10, (0.0, 0.0, 1.9234e-4))
SPIN = np.array(CERES.spin_rad_s)


def descent(step_s=5.0, noise_m=0.0, noise_m_s=0.0):
    """Times, positions and velocities of a descent over 150 s whose engine burns from the middle on."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 150.1, step_s)
    late = np.maximum(t - 73.0, 0.0)[:, None]
    start, speed, thrust = np.array([3.2e5, -3.8e5, -1.9e5]), np.array([-20.0, 300.0, 5.0]), [0.5, -2.0, 1.0]
    P = start + t[:, None] * speed + 0.5 * late**2 * thrust
    V = speed + late * thrust
    return t, P + noise_m * rng.standard_normal(P.shape), V + noise_m_s * rng.standard_normal(V.shape)


def read(folder, t, P, V, *, one_motion=True):
    stamps = np.round(1e9 * t).astype(np.int64)
    columns = [stamps, *P.T, np.ones(len(t)), *np.zeros((3, len(t))), *V.T, *np.zeros((6, len(t)))]
    write_table(folder / "data.csv", layout.TRUTH_COLUMNS, columns)
    return read_states(folder / "data.csv", stamps, CERES, one_motion=one_motion)


@pytest.mark.parametrize(
    "given", [{}, {"step_s": 30.0}, {"step_s": 0.1, "noise_m": 1.0}, {"noise_m": 20.0, "noise_m_s": 0.5}]
)
def test_coarse_and_noisy_truth_is_accepted(tmp_path, given):
    t, P, V = descent(**given)
    np.testing.assert_allclose(read(tmp_path, t, P, V).gP, P)


def test_a_truth_deep_in_the_body_is_refused(tmp_path):
    t, P, V = descent()
    for wrong in (1e-3 * P, P - P[-1]):
        with pytest.raises(InputError, match=r"data\.csv:2: p_RS_R_x,.*: expected metres.*deep in the body"):
            read(tmp_path, t, wrong, V, one_motion=False)


# The last: rows at the largest distance that counts.
@pytest.mark.parametrize("given", [{}, {"step_s": 1.0, "noise_m": 1.0}, {"step_s": 30.0}])
def test_velocities_that_contradict_the_positions_are_refused(tmp_path, given):
    t, P, V = descent(**given)
    with pytest.raises(InputError, match=r"data\.csv: v_RS_R_x,.*rotation beside it, .* in inertial space\?"):
        read(tmp_path, t, P, V + np.cross(SPIN, P))
    for wrong in (1e-3 * V, -V, 0.0 * V, V[:, [1, 0, 2]]):
        with pytest.raises(InputError, match=r"relative to g, as the positions move, found velocities that"):
            read(tmp_path, t, P, wrong)
    # A-priori states may be of several solutions.
    assert len(read(tmp_path, t, P, -V, one_motion=False)) == len(t)


def test_a_file_without_rows_is_refused(tmp_path):
    write_table(tmp_path / "data.csv", layout.TRUTH_COLUMNS, np.empty((17, 0)))
    with pytest.raises(InputError, match=r"data\.csv: expected at least one row, found none"):
        read_states(tmp_path / "data.csv", np.array([0, 10**9]), CERES, one_motion=True)
