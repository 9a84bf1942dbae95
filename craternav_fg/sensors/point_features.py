"""Point features: image points of unknown ground points, followed from frame to frame without a map.

They determine the motion between frames but not the position, and so bridge stretches without craters. Their
factor is the reprojection of an estimated ground point (`estimators.point_features`); the filter
eliminates the ground point (`estimators.ekf.point_features`).
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from craternav_fg.body import ground_points
from craternav_fg.camera import Camera
from craternav_fg.config import Positive, Section, read_text, validate
from craternav_fg.sensors.protocol import Surroundings
from craternav_fg.sensors.yaml_files import dump_yaml, parse_yaml
from craternav_fg.tables import Column, read_table, write_table
from factors.arrays import FloatArray, IntArray

NAME = "features"
FOLDER = f"mav0/{NAME}0"
SETTINGS, DATA = "sensor.yaml", "data.csv"
STAMP, TRACK, X_PX, Y_PX = "timestamp", "track_id", "x", "y"
_COLUMNS = (
    Column(STAMP, "integer", unit="ns"),
    Column(TRACK, "integer"),
    Column(X_PX, unit="px"),
    Column(Y_PX, unit="px"),
)


class FeatureSettings(Section):
    """`mav0/features0/sensor.yaml`."""

    sensor_type: Literal["point_features"] = "point_features"
    comment: str | None = None
    sigma_px: Positive = 0.3
    """Standard deviation of an image coordinate."""
    loss_sigmas: Positive = 3.0
    """Norm of a whitened reprojection beyond which an observation loses weight (Huber)."""


class FeatureSimulation(Section):
    """How tracks are drawn: the table `simulation` in a scenario's `[sensors.features]`."""

    count: Annotated[int, Field(ge=1, le=2000)] = 60
    """Tracks in an image."""
    loss_share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.05
    """Share of the tracks that end from one frame to the next, though their point stays in the image."""
    outlier_share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Share of the observations that are off by up to 20 px."""


@dataclass(frozen=True)
class FeatureTracks:
    """Observations of tracked points.

    Attributes
    ----------
    settings : FeatureSettings
    stamps_ns : ndarray of int, shape (n,)
        Stamps of the observations, not decreasing: stamps of frames, ns.
    tracks : ndarray of int, shape (n,)
        Which ground point each is of, a number without meaning.
    points_px : ndarray, shape (n, 2)
        In the image as it was taken, lens distortion and all, px.
    """

    settings: FeatureSettings
    stamps_ns: IntArray
    tracks: IntArray
    points_px: FloatArray

    def at(self, stamp_ns: int) -> tuple[IntArray, FloatArray]:
        """Observations of one frame.

        Parameters
        ----------
        stamp_ns : int

        Returns
        -------
        tracks : ndarray of int, shape (m,)
        points_px : ndarray, shape (m, 2)
            px.
        """
        lo, hi = np.searchsorted(self.stamps_ns, [stamp_ns, stamp_ns + 1])
        return self.tracks[lo:hi], self.points_px[lo:hi]


def read_features(folder: Path, camera: Camera, frames_ns: IntArray) -> FeatureTracks | None:
    """Read the tracks of a data set; None when it has none.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    camera : Camera
    frames_ns : ndarray of int, shape (k,)
        Stamps of the frames, ns.

    Returns
    -------
    FeatureTracks or None

    Raises
    ------
    InputError
        Naming file, line and column: a stamp that is no frame's, a point outside the image, a track that is
        seen twice in a frame.
    """
    here = folder / FOLDER
    if not here.is_dir():
        return None
    text = read_text(here / SETTINGS)
    settings = validate(here / SETTINGS, parse_yaml(here / SETTINGS, text), FeatureSettings, text=text)
    table = read_table(here / DATA, _COLUMNS)
    stamps, tracks = table.columns[STAMP], table.columns[TRACK]
    points = table.numbers(X_PX, Y_PX)
    for row in np.flatnonzero(~np.isin(stamps, frames_ns)).tolist():
        table.fail(row, STAMP, f"expected the stamp of a frame, found {stamps[row]}")
    for row in np.flatnonzero(np.diff(stamps) < 0).tolist():
        table.fail(row + 1, STAMP, f"expected {stamps[row]} or later, found {stamps[row + 1]}")
    size = np.array([camera.width_px, camera.height_px])
    for row in np.flatnonzero(((points < -0.5) | (points > size - 0.5)).any(axis=1)).tolist():
        axis = int(np.argmax((points[row] < -0.5) | (points[row] > size - 0.5)))
        table.fail(
            row, (X_PX, Y_PX)[axis],
            f"expected a pixel of the {size[0]} x {size[1]} image, found {points[row, axis]:g}",
        )  # fmt: skip
    _, first, count = np.unique(
        np.stack([stamps, tracks], axis=1), axis=0, return_index=True, return_counts=True
    )
    for row in first[count > 1].tolist():
        table.fail(row, TRACK, f"expected each track once in a frame, found {tracks[row]} twice")
    return FeatureTracks(settings, stamps, tracks, points)


def write_features(folder: Path, tracks: FeatureTracks) -> None:
    """Write tracks into a data set; numbers read back exactly.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    tracks : FeatureTracks
    """
    here = folder / FOLDER
    here.mkdir(parents=True)
    plain = json.loads(tracks.settings.model_dump_json(exclude_none=True))
    (here / SETTINGS).write_text(dump_yaml(plain), encoding="utf-8")
    columns = [tracks.stamps_ns, tracks.tracks, *tracks.points_px.T]
    write_table(here / DATA, _COLUMNS, columns, comment=True)


def simulate_features(
    settings: FeatureSettings,
    plan: FeatureSimulation,
    camera: Camera,
    poses: Sequence[tuple[int, FloatArray]],
    surroundings: Surroundings,
    rng: np.random.Generator,
) -> FeatureTracks:
    """Draw the tracks that a camera would follow along a true motion.

    Parameters
    ----------
    settings : FeatureSettings
    plan : FeatureSimulation
    camera : Camera
    poses : sequence of (int, ndarray)
        Stamp, ns, and true pose gTb (4, 4) of each frame, m.
    surroundings : Surroundings
        The true ones: points lie on the ground at its height.
    rng : numpy.random.Generator

    Returns
    -------
    FeatureTracks
    """
    alive = np.empty((0, 3))
    names = np.empty(0, dtype=np.int64)
    begun = 0
    stamps: list[IntArray] = []
    tracks: list[IntArray] = []
    points: list[FloatArray] = []
    for stamp, gTb in poses:
        gTc = camera.gTc(gTb)
        kept = _in_view(alive, gTc, camera) & (rng.random(len(alive)) >= plan.loss_share)
        alive, names = alive[kept], names[kept]
        new = _new_points(plan.count - len(alive), gTc, camera, surroundings, rng)
        alive = np.concatenate([alive, new])
        names = np.concatenate([names, begun + np.arange(len(new), dtype=np.int64)])
        begun += len(new)
        px = camera.project((alive - gTc[:3, 3]) @ gTc[:3, :3])
        px = px + settings.sigma_px * rng.standard_normal(px.shape)
        wrong = rng.random(len(px)) < plan.outlier_share
        px[wrong] += rng.uniform(-20.0, 20.0, (int(wrong.sum()), 2))
        inside = camera.contains(px)
        stamps.append(np.full(int(inside.sum()), stamp, dtype=np.int64))
        tracks.append(names[inside])
        points.append(px[inside])
    return FeatureTracks(settings, np.concatenate(stamps), np.concatenate(tracks), np.concatenate(points))


def _in_view(gL: FloatArray, gTc: FloatArray, camera: Camera) -> npt.NDArray[np.bool_]:
    """Whether ground points (n, 3) face the camera and lie in its image."""
    seen = (gL - gTc[:3, 3]) @ gTc[:3, :3]
    facing = np.sum(gL * (gTc[:3, 3] - gL), axis=1) > 0.0
    out = facing & (seen[:, 2] > 0.0)
    out[out] = camera.contains(camera.project(seen[out]))
    return np.asarray(out)


def _new_points(
    count: int, gTc: FloatArray, camera: Camera, surroundings: Surroundings, rng: np.random.Generator
) -> FloatArray:
    """Ground points (m, 3), m at most `count`, under pixels drawn all over the image."""
    px = rng.uniform(0.0, [camera.width_px - 1.0, camera.height_px - 1.0], (max(count, 0), 2))
    radius_m = surroundings.body.radius_m
    level, hit = ground_points(gTc[:3, :3], gTc[:3, 3], camera.normalised(px), radius_m)
    height_m: Callable[[FloatArray], float] = surroundings.height_m
    directions = level[hit] / np.linalg.norm(level[hit], axis=1, keepdims=True)
    raised = np.array([radius_m + height_m(direction) for direction in directions])
    out = directions * raised[:, None]
    return np.asarray(out[_in_view(out, gTc, camera)])
