"""Apollo 15's photographs by the commands of the documentation, and variants of their reconstruction.

`python -m tests.pipeline.apollo15` prints what `docs/howto/apollo15.md` says of how far to trust the
scatter, and the focal length if it is estimated.
"""

import re
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from craternav_fg.dataset import Dataset
from craternav_fg.evaluation.offsets import Offsets, leave_one_out, offsets
from craternav_fg.pipeline.options_file import OptionsFile
from craternav_fg.pipeline.reconstruct import reconstruct
from factors.arrays import FloatArray
from tests.cli.calls import call
from tests.shared_data import shared

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "apollo15.md").read_text(encoding="utf-8")
# Rows of the table by the beginning of their names: a key of the page's options, and its value.
VARIANTS = {
    "as above": ("min_semi_minor_px", "8.0"),
    "edge points of rims": ("full_arc_share", "0.5"),
    "rims searched again": ("recentrings", "3\nsearches = 1"),
    "rims searched from five places": ("recentrings", "3"),
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
    path = folder / f"{key}_{value.partition(chr(10))[0]}_{len(value)}.toml"
    if not count:
        table = _TABLES.get(key, "[front_end]")
        changed = f"{table}\n{key} = {value}\n{text.removeprefix(table)}"
    path.write_text(changed)
    return OptionsFile(path)


@dataclass(frozen=True)
class Outcome:
    """What a reconstruction says of itself.

    `offsets` are those of the smoother from SPICE; `left_out` is the mean squared error, over its variance,
    of frames that the others predict.
    """

    offsets: Offsets
    drift_m_s: FloatArray
    rims: int
    left_out: float
    focal: str

    @property
    def scatter_m(self) -> float:
        """Scatter of the positions about their mean offset, all three axes together."""
        return float(np.linalg.norm(self.offsets.scatter_m))


def outcome(data: Dataset, options: OptionsFile) -> Outcome:
    """Reconstruct the photographs with the smoother and compare it with SPICE and with itself."""
    smoother = options.estimator("smoother")
    result = reconstruct(data, [smoother], front_end=options.front_end)
    trajectory = result.trajectories["smoother"]
    assert data.apriori is not None
    found = offsets(trajectory, data.apriori.states)
    seconds = 1e-9 * (trajectory.stamps_ns - trajectory.stamps_ns[0])
    drift = np.polyfit(seconds, found.enu_m[:, :2], 1)[0]
    left = leave_one_out(result.problems, smoother, trajectory.stamps_ns)
    focal = ""
    if trajectory.calibrated is not None and trajectory.calibrated.intrinsics is not None:
        (share, *_), (sigma, *_) = trajectory.calibrated.intrinsics
        focal = f", focal length {100.0 * share:.1f} ± {100.0 * sigma:.1f} % longer"
    rims = sum(len(frame.rims) for frame in result.frames)
    return Outcome(found, drift, rims, float(np.mean((left.enu_m / left.sigma_m) ** 2)), focal)


def altered(data: Dataset, folder: Path, seed: int) -> Dataset:
    """Copy of the data set in whose images one pixel in fifty differs by one grey level."""
    folder.mkdir(exist_ok=True)
    paths = []
    for k, path in enumerate(data.image_paths):
        rng = np.random.default_rng(1000 * seed + k)
        image = data.image(k)
        hit = rng.random(image.shape) < 0.02
        step = np.where(rng.random(image.shape) < 0.5, 1, -1)
        most = np.iinfo(image.dtype).max
        changed = np.clip(image.astype(np.int64) + hit * step, 0, most).astype(image.dtype)
        paths.append(folder / f"{seed}_{path.name}")
        cv2.imwrite(str(paths[-1]), changed)
    return replace(data, image_paths=tuple(paths))


def row_of(first: Outcome, copies: list[Outcome]) -> str:
    """The table's row of a variant: the photographs, and several altered copies of them."""
    cells = [", ".join(f"{one:.0f}" for one in first.offsets.scatter_m) + " m"]
    for name, digits, unit in (("scatter_m", 0, " m"), ("left_out", 2, "")):
        values = [getattr(one, name) for one in copies]
        cells.append(f"{np.mean(values):.{digits}f} ± {np.std(values, ddof=1):.{digits}f}{unit}")
    mean = ", ".join(f"{one:.0f}" for one in first.offsets.enu_m.mean(axis=0))
    told = f"{first.rims} rims, drift {first.drift_m_s.round(1)} m/s, mean offset {mean} m{first.focal}"
    return " | ".join([*cells, told])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as work:
        arc = import_arc(Path(work))
        others = [altered(arc, Path(work) / "altered", seed) for seed in range(1, 9)]
        for name, (key, value) in VARIANTS.items():
            chosen = options_with(Path(work), key, value)
            row = row_of(outcome(arc, chosen), [outcome(one, chosen) for one in others])
            sys.stdout.write(f"| {name} | {row} |\n")
            sys.stdout.flush()
