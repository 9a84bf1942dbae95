"""Apollo 15's photographs by the commands of the documentation, and variants of their reconstruction.

`python -m tests.pipeline.apollo15` prints what `docs/howto/apollo15.md` says of how far to trust the
scatter, and the focal length if it is estimated.
"""

import re
import sys
import tempfile
from pathlib import Path

import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.offsets import offsets
from craternav_fg.pipeline.options_file import OptionsFile
from craternav_fg.pipeline.reconstruct import reconstruct
from tests.cli.calls import call
from tests.shared_data import shared

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "apollo15.md").read_text(encoding="utf-8")
# Rows of the table by the beginning of their names: a key of the page's options, and its value.
VARIANTS = {
    "as above": ("min_semi_minor_px", "8.0"),
    "edge points of rims": ("full_arc_share", "0.5"),
    "rims searched again": ("recentrings", "3"),
    "no second search": ("map_error_sigmas", "0.0"),
    "floor of 0.2 px": ("floor_px", "0.2"),
    "floor of 0.5 px": ("floor_px", "0.5"),
    "focal length estimated": ("focal_sigma_share", "0.01"),
}
# Table of a key that the page's options do not have.
_TABLES = {"focal_sigma_share": "[estimators.smoother.calibration]"}


def block(kind: str, beginning: str) -> str:
    """The block of the page that begins so."""
    return next(
        text for text in re.findall(rf"```{kind}\n(.*?)```", PAGE, re.S) if text.startswith(beginning)
    )


def import_arc(folder: Path) -> Dataset:
    """Merge the catalogues and import the photographs, as the page does."""
    catalogs = [str(shared(f"{name}.csv")) for name in ("robbins_2018_subset", "moon_head_povilaitis_5km")]
    craters, dem = str(folder / "craters.parquet"), str(shared("gld100/gld100_16ppd_global.tif"))
    call("catalog", "merge", *catalogs, "-o", craters, "--dem", dem)
    times = folder / "times.csv"
    times.write_text(block("text", "filename,utc"))
    cubes = [str(shared(f"apollo15/AS15-M-0{k}_crop.cub")) for k in range(297, 301)]
    images = [str(shared(f"apollo15/AS15-M-0{k}_SML.png")) for k in range(295, 301)]
    given = [text for image in images for text in ("--photographs", image)]
    where = str(folder / "data")
    call("import", "isis", *cubes, *given, "--times", str(times), "--catalog", craters, "-o", where)
    return Dataset.open(where)


def options_with(folder: Path, key: str, value: str) -> OptionsFile:
    """The page's options with another value of one key."""
    text = block("toml", "[front_end]")
    changed, count = re.subn(rf"^{key} = \S+", f"{key} = {value}", text, flags=re.MULTILINE)
    path = folder / f"{key}_{value}.toml"
    if not count:
        table = _TABLES.get(key, "[front_end]")
        changed = f"{table}\n{key} = {value}\n{text.removeprefix(table)}"
    path.write_text(changed)
    return OptionsFile(path)


def scatter_and_drift(data: Dataset, options: OptionsFile) -> str:
    """Scatter of the smoother's offsets from SPICE and their drift, as a row of the table has them."""
    result = reconstruct(data, [options.estimator("smoother")], front_end=options.front_end)
    trajectory = result.trajectories["smoother"]
    assert data.apriori is not None
    found = offsets(trajectory, data.apriori.states)
    seconds = 1e-9 * (trajectory.stamps_ns - trajectory.stamps_ns[0])
    east, north = np.polyfit(seconds, found.enu_m[:, :2], 1)[0]
    rims = sum(len(frame.rims) for frame in result.frames)
    scatter = ", ".join(f"{one:.0f}" for one in found.scatter_m)
    mean = ", ".join(f"{one:.0f}" for one in found.enu_m.mean(axis=0))
    told = f"{rims} rims, mean offset {mean} m, sigma up {np.median(found.sigma_m[:, 2]):.0f} m"
    if trajectory.calibrated is not None and trajectory.calibrated.intrinsics is not None:
        (share, *_), (sigma, *_) = trajectory.calibrated.intrinsics
        told += f", focal length {100.0 * share:.1f} ± {100.0 * sigma:.1f} % longer"
    return f"{scatter} m | {east:.1f}, {north:.1f} m/s | {told}"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as work:
        arc = import_arc(Path(work))
        for name, (key, value) in VARIANTS.items():
            sys.stdout.write(f"| {name} | {scatter_and_drift(arc, options_with(Path(work), key, value))} |\n")
            sys.stdout.flush()
