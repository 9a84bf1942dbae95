"""What the true variances of rims' errors would give: python -m tests.foreign.variance_components [KIND...].

Errors against the catalogue's rims, seen from the true pose, are split into what each crater keeps over the
frames and what is new in each frame. With both variances known, the smoother is run on the measured rims,
and on rims whose errors are drawn with just these variances: no estimate of the variances can do better.
"""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from craternav_fg.dataset import Dataset
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.registry import estimator
from craternav_fg.estimators.start import make_problem
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray
from factors.kernels.conic import project_rims
from factors.kernels.rim_errors import ground_slopes
from tests.foreign.files import write
from tests.foreign.worlds import KINDS, draw_world

SEEDS = (1, 2, 3)
ESTIMATORS = ("smoother", "centre_smoother")
# Error, px, in any component beyond which a rim is another crater's.
_OUTLIER_PX = 5.0
_IN_PLANE = [0, 1, 3, 4, 5]
say = Console(width=160, highlight=False, markup=False).print


@dataclass(frozen=True)
class Seen:
    """A frame's rims from the true pose.

    `charts` (n, 5) are those of the catalogue's rims; `per_px` (n, 5, 5) is what an error of a pixel in the
    rim's plane does to them: shift along both axes, growth along the first, shear, growth along the second.
    """

    rims: RimSet
    charts: FloatArray
    per_px: FloatArray

    @property
    def errors_px(self) -> FloatArray:
        """Errors (n, 5) of the measured rims."""
        return np.linalg.solve(self.per_px, (self.rims.chart - self.charts)[:, :, None])[:, :, 0]

    @property
    def white_px(self) -> FloatArray:
        """Stated standard deviations (n, 5) of the white part."""
        inverse = np.linalg.inv(self.per_px)
        covariance = inverse @ self.rims.uncorrelated_covariance @ np.swapaxes(inverse, 1, 2)
        return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))

    def with_variances(self, kept_px: FloatArray, white_px: FloatArray) -> RimSet:
        """Rims whose covariance consists of these standard deviations (5,) alone."""
        correlated, white = self.per_px * kept_px, self.per_px * white_px
        covariance = correlated @ np.swapaxes(correlated, 1, 2) + white @ np.swapaxes(white, 1, 2)
        return replace(self.rims, covariance=covariance, correlated=correlated, shared=None)

    def drawn(self, z: FloatArray) -> "Seen":
        """Rims with errors z (n, 5), px, in place of the measured ones."""
        moved = self.charts + (self.per_px @ z[:, :, None])[:, :, 0]
        return replace(self, rims=replace(self.rims, chart=moved))


def split(craters: IntArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of what each crater keeps, and of what is new, from errors (n, k)."""
    rows, counts = np.unique(craters, return_inverse=True, return_counts=True)[1:]
    sums = np.zeros((len(counts), errors.shape[1]))
    np.add.at(sums, rows, errors)
    means = sums / counts[:, None]
    white2 = np.sum((errors - means[rows]) ** 2, axis=0) / max(len(rows) - len(counts), 1)
    kept2 = np.mean(means**2, axis=0) - white2 * np.mean(1.0 / counts)
    return np.sqrt(np.maximum(kept2, 1e-6)), np.sqrt(white2)


def from_truth(data: Dataset, frames: tuple[FrameMeasurement, ...]) -> list[Seen]:
    """Rims of all frames from the true poses."""
    assert data.truth is not None
    out = []
    for frame, gTb in zip(frames, data.truth.gTb, strict=True):
        centres, axes = data.catalog.centres[frame.rims.craters], data.catalog.axes[frame.rims.craters]
        pose = np.ascontiguousarray(gTb)
        charts = project_rims(pose, data.camera.bTc, centres, axes)[0]
        radius_px = data.camera.focal_px * np.exp(0.5 * (charts[:, 2] + charts[:, 4]))
        slopes = ground_slopes(pose, data.camera.bTc, centres, axes)[:, :, _IN_PLANE]
        out.append(Seen(frame.rims, charts, slopes / radius_px[:, None, None]))
    return out


def rms_m(data: Dataset, estimated: Trajectory) -> float:
    """Root mean square of the position's error, m."""
    assert data.truth is not None
    off = estimated.gTb[:, :3, 3] - data.truth.gTb[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def main(kinds: list[str]) -> None:
    """Print for each descent the errors' parts, and RMS of smoother and centre_smoother in three cases."""
    table = []
    say("kept, new, stated as new: px, mean of five components; RMS m of smoother and centre_smoother: "
        "as stated; with true variances; errors drawn with these")  # fmt: skip
    for kind in kinds or list(KINDS):
        for seed in SEEDS:
            world = draw_world(seed, kind)
            with tempfile.TemporaryDirectory() as folder:
                data = Dataset.open(write(world, Path(folder) / "data", seed))
                result = reconstruct(data, ESTIMATORS)
                seen = from_truth(data, result.frames)
                errors = np.concatenate([one.errors_px for one in seen])
                craters = np.concatenate([one.rims.craters for one in seen])
                good = (np.abs(errors) < _OUTLIER_PX).all(axis=1)
                kept, white = split(craters[good], errors[good])
                z = np.random.default_rng(seed).standard_normal((len(data.catalog), 5))
                rng = np.random.default_rng([seed, 1])
                cases = [seen, [
                    one.drawn(kept * z[one.rims.craters] + white * rng.standard_normal(one.charts.shape))
                    for one in seen
                ]]  # fmt: skip
                row = [rms_m(data, result.trajectories[name]) for name in ESTIMATORS]
                for case in cases:
                    frames = [
                        replace(frame, rims=one.with_variances(kept, white))
                        for frame, one in zip(result.frames, case, strict=True)
                    ]
                    problem = make_problem(Descent.of(data), frames)
                    row += [rms_m(data, estimator(name).estimate(problem)) for name in ESTIMATORS]
                stated = np.median(np.concatenate([one.white_px for one in seen]), axis=0)
            table.append(row)
            parts = " ".join(f"{np.mean(v):5.2f}" for v in (kept, white, stated))
            say(f"{kind:8}{seed:2}  {parts}  " + " ".join(f"{v:7.2f}" for v in row))
    mean = np.mean(table, axis=0)
    say("mean" + 26 * " " + " ".join(f"{v:7.2f}" for v in mean))
    say("ratio, descents in which the smoother is better: " + ", ".join(
        f"{mean[k] / mean[k + 1]:.2f}, {sum(row[k] < row[k + 1] for row in table)} of {len(table)}"
        for k in (0, 2, 4)))  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
