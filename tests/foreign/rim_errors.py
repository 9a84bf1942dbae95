"""Errors of measured rims against the crests in the ground: centre, size, shape, and what was claimed."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.dataset import Dataset
from craternav_fg.measurements import RimSet
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.arrays import FloatArray
from tests.foreign.motion import BODY_CAMERA
from tests.foreign.worlds import World

# Squared distance per dimension of rims that are another crater's, or another ring of it.
_OUTLIER = 100.0


@dataclass(frozen=True)
class RimErrors:
    """Errors of n rims: centre (n, 2) in px; relative ones of size and of the axes' ratio; claims."""

    crater: npt.NDArray[np.int64]
    centre_px: FloatArray
    size: FloatArray
    shape: FloatArray
    radius_px: FloatArray
    chi2: FloatArray

    @classmethod
    def joined(cls, parts: list["RimErrors"]) -> "RimErrors":
        """Errors of several frames, rims of something else left out."""
        whole = cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in cls.__dataclass_fields__))
        return whole.take(whole.chi2 < _OUTLIER)

    def take(self, rows: npt.NDArray[np.bool_]) -> "RimErrors":
        """Select rims."""
        return RimErrors(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def summary(self) -> dict[str, float]:
        """Root mean squares, the bias of sizes, and the mean squared distance per dimension."""
        return {
            "rims": float(len(self.size)),
            "centre_px": float(np.sqrt(np.mean(self.centre_px**2))),
            "size_bias_percent": 100.0 * float(np.mean(self.size)),
            "size_px": float(np.sqrt(np.mean((self.size * self.radius_px) ** 2))),
            "shape_px": float(np.sqrt(np.mean((self.shape * self.radius_px) ** 2))),
            "chi2": float(np.mean(self.chi2)),
        }


def errors_from_truth(world: World, data: Dataset, sigma: FloatArray) -> RimErrors:
    """Measure the rims of all frames from the true poses, said to be known to sigma (6,), rad and m."""
    assert data.truth is not None
    front_end = GuidedFrontEnd(data.camera, data.catalog)
    parts = []
    for k, stamp in enumerate(data.stamps_ns.tolist()):
        frame = front_end.measure(
            data.image(k), stamp, data.truth.gTb[k], np.diag(sigma**2), data.sun.at(stamp)
        )
        parts.append(errors_of_frame(world, k, frame.rims))
    return RimErrors.joined(parts)


def errors_of_frame(world: World, frame: int, rims: RimSet) -> RimErrors:
    """Compare a frame's rims with the crests that the camera saw; crater k has the catalogue's row k."""
    t, focal_px = world.times_s[frame], world.optics.focal_px
    eye, axes = world.motion.position(t), world.motion.attitude(t) @ BODY_CAMERA
    rows = []
    for crater, chart, covariance in zip(rims.craters, rims.chart, rims.covariance, strict=True):
        seen = (world.ground.craters.crests[crater] - eye) @ axes
        middle, matrix = _ellipse(seen[:, :2] / seen[:, 2:])
        root = np.linalg.cholesky(matrix)
        truth = np.array([*middle, np.log(root[0, 0]), root[1, 0] / root[0, 0], np.log(root[1, 1])])
        off = chart - truth
        measured = np.exp(chart[2]) * np.array([[1.0, 0.0], [chart[3], np.exp(chart[4] - chart[2])]])
        true_axes = np.sqrt(np.linalg.eigvalsh(matrix))
        found_axes = np.linalg.svd(measured)[1][::-1]
        growth = np.log(found_axes / true_axes)
        rows.append(
            (
                crater, focal_px * off[:2], growth.mean(), growth[1] - growth[0],
                focal_px * np.sqrt(true_axes.prod()), off @ np.linalg.solve(covariance, off) / 5.0,
            )
        )  # fmt: skip
    columns = list(zip(*rows, strict=True)) if rows else [()] * 6
    crater, centre, size, shape, radius, chi2 = (np.array(column) for column in columns)
    return RimErrors(crater.astype(np.int64), centre.reshape(-1, 2), size, shape, radius, chi2)


def _ellipse(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre and matrix S of the ellipse (x - m)' S^-1 (x - m) = 1 nearest to points: Gauss-Newton."""
    middle = points.mean(axis=0)
    off = points - middle
    P = np.linalg.inv(2.0 * off.T @ off / len(points))
    for _ in range(8):
        off = points - middle
        value = np.einsum("ki,ij,kj->k", off, P, off)
        A = np.column_stack([off[:, 0] ** 2, 2.0 * off[:, 0] * off[:, 1], off[:, 1] ** 2, -2.0 * off @ P])
        # Distances, not squares of them: each row over the gradient's length.
        weight = 1.0 / np.linalg.norm(2.0 * off @ P, axis=1)
        scale = np.linalg.norm(A * weight[:, None], axis=0)
        step = np.linalg.lstsq(A * weight[:, None] / scale, (1.0 - value) * weight, rcond=None)[0] / scale
        P = P + np.array([[step[0], step[1]], [step[1], step[2]]])
        middle = middle + step[3:]
    return middle, np.linalg.inv(P)
