"""Warnings are the same on the command line, in the run's files, in the report and in a notebook."""

import html
from pathlib import Path

import craternav_fg as cn
from tests import descents
from tests.cli.calls import call

START = "craternav: warning: "


def test_every_place_shows_the_same_warnings(tmp_path: Path) -> None:
    data, run = tmp_path / "data", tmp_path / "run"
    cn.simulate(descents.scenario(duration_s=20.0), data)
    # A sensor that nothing reads, its name as awkward as a name may be in a page.
    (data / "mav0" / "radar<&>0").mkdir()
    result = cn.reconstruct(data, ["smoother", "ekf"], without=["rims"])
    assert len(result.warnings) >= 2
    done = call("reconstruct", data, "-o", run, "-e", "smoother,ekf", "--without", "rims")
    told = [line.removeprefix(START) for line in done.err.splitlines() if line.startswith(START)]
    assert told == list(result.warnings)
    assert cn.read_run(run).metrics["warnings"] == list(result.warnings)
    assert call("report", run).code == 0
    for page in ((run / "report.html").read_text(encoding="utf-8"), result._repr_html_()):
        assert "radar<&>0" not in page
        assert all(warning in html.unescape(page) for warning in told)
