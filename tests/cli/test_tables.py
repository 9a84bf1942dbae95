"""Tables of estimators fit into 80 characters, and cut no number in any terminal."""

import pytest
from rich.console import Console

from craternav_fg.cli import campaigns, run_summary
from craternav_fg.estimators.registry import ESTIMATORS

LONG = {
    "position_rms_m": 1165.98, "position_final_m": 2123.5, "velocity_rms_m_s": 0.0182,
    "attitude_rms_deg": 0.00572, "attitude_final_deg": 0.0155, "anees": 461675.3,
    "from_smoother_rms_m": 1166.2, "converged": 30, "position_final_mean_m": 716.6,
    "position_final_rms_m": 1853.3, "attitude_final_mean_deg": 0.0172, "rms_over_pcrb": 0.0746,
    "time_per_trial_s": 0.0123, "trajectories": 30,
}  # fmt: skip


@pytest.mark.parametrize("width", [80, 60])
@pytest.mark.parametrize("command", ["compare", "montecarlo"])
def test_no_number_is_cut(
    command: str, width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = {"compare": run_summary, "montecarlo": campaigns}[command]
    monkeypatch.setattr(module, "out", Console(width=width))
    estimators = dict.fromkeys(ESTIMATORS, LONG | {"anees_trials": 30})
    if command == "compare":
        run_summary.show_comparison([("run", estimators)])
    else:
        campaigns._show(run_summary.Path("campaign"), {"trials": 30, "wall_s": 1.0, "estimators": estimators})
    shown = capsys.readouterr().out
    assert "…" not in shown
    numbers = {"1166", "461675", "0.00572"} if command == "compare" else {"717", "461675", "0.0123"}
    rows = [line.split() for line in shown.splitlines() if "461675" in line]
    assert len(rows) == len(ESTIMATORS)
    assert all(numbers <= set(row) for row in rows)
    assert width < 80 or {row[0] for row in rows} == set(ESTIMATORS)
