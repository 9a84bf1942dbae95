"""What is spoilt, and the commands that then read it."""

import time
from pathlib import Path
from unittest import mock

import numpy as np

from craternav_fg.campaign import run as campaign_run
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.ellipses import write_detected_ellipses, write_matched_ellipses
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.runs.execute import execute_run
from craternav_fg.simulation.catalog_views import ViewOptions, random_view, synthetic_catalog
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenes import MOON
from tests.campaign import inline
from tests.campaign.scene import options, small_scenario, write_scenario
from tests.descents import scenario
from tests.fuzz.foreign_targets import foreign_targets
from tests.fuzz.target import Target


def every_file(folder: Path) -> list[Path]:
    return sorted(
        path for path in folder.rglob("*") if path.is_file() and path.suffix not in (".tum", ".png")
    )


def make_targets(folder: Path) -> dict[str, Target]:
    """Make one sound example of everything that is read."""
    data = simulate(scenario(duration_s=6.0), folder / "data")
    run = folder / "run"
    run.mkdir()
    execute_run(
        Dataset.open(data), run, ["smoother", "dead_reckoning"], label=str(data), began_s=time.perf_counter()
    )
    with mock.patch.object(campaign_run, "processes", inline.processes):
        campaign_run.montecarlo(small_scenario(), folder / "campaign", options(2, workers=1))
    view = folder / "view"
    view.mkdir()
    rng = np.random.default_rng(1)
    catalog = synthetic_catalog(MOON, rng, count=800)
    scene = random_view(catalog, ViewOptions(), rng, true_rims=(8, 30))
    write_catalog(view / "craters.csv", catalog)
    write_catalog(view / "craters.parquet", catalog)
    TripleIndex.build(catalog).save(view / "index.npz")
    traced = np.ones(len(scene.ellipses_px), dtype=np.bool_)
    write_detected_ellipses(view / "rims.csv", scene.ellipses_px, traced, "one.png")
    names = [catalog.identifiers[row] if row >= 0 else None for row in scene.craters]
    write_matched_ellipses(view / "matched.csv", scene.ellipses_px, names)
    (view / "sensor.yaml").write_text(camera_yaml(scene.camera, 1.0))
    write_scenario(view / "scenario.toml", scenario(duration_s=4.0))

    def seen(here: Path) -> list[list[str]]:
        camera = ["--camera", f"{here}/sensor.yaml", "--catalog"]
        return [
            [
                "identify",
                f"{here}/rims.csv",
                *camera,
                f"{here}/craters.parquet",
                "--index",
                f"{here}/index.npz",
            ],
            ["pose", f"{here}/matched.csv", *camera, f"{here}/craters.csv"],
            ["catalog", "info", f"{here}/craters.csv"],
            ["catalog", "import", f"{here}/craters.parquet", "-o", f"{here}/out.csv"],
            ["simulate", f"{here}/scenario.toml", "-o", f"{here}/out"],
        ]

    return {
        "data": Target(
            data,
            every_file,
            lambda here: [["reconstruct", str(here), "-o", f"{here}-run", "-e", "dead_reckoning"]],
        ),
        "run": Target(run, every_file, lambda here: [["report", str(here)], ["compare", str(here)]]),
        "campaign": Target(folder / "campaign", every_file, lambda here: [["report", str(here)]]),
        "view": Target(view, every_file, seen),
        **foreign_targets(folder),
    }
