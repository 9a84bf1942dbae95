"""The static solver's cost: within its budgets, and below SciPy's on the same problem."""

from craternav_fg.bench.static import static_scalars


def test_the_static_solver_is_fast() -> None:
    scalars = static_scalars(repetitions=60)
    assert set(scalars) == {"pose_ms_n3", "pose_ms_n10", "pose_vs_scipy_ratio"}
    # Twice the budget: the machine may be busy.
    assert 0.0 < scalars["pose_ms_n3"] < 2.0
    assert 0.0 < scalars["pose_ms_n10"] < 3.0
    assert 0.0 < scalars["pose_vs_scipy_ratio"] < 0.2
