"""Cost of the resection solver: within its budget, and below SciPy's on the same problem."""

from craternav_fg.bench.resection import resection_scalars


def test_the_resection_solver_is_fast() -> None:
    scalars = resection_scalars(repetitions=60)
    assert set(scalars) == {"pose_ms_n3", "pose_ms_n10", "pose_vs_scipy_ratio"}
    assert 0.0 < scalars["pose_ms_n3"] <= 1.0
    assert 0.0 < scalars["pose_ms_n10"] <= 1.5
    assert 0.0 < scalars["pose_vs_scipy_ratio"] <= 0.1
