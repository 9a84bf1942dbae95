"""Small data sets, numbers as awkward as they come, and ways to spoil them."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Recording, SunVectors
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import ArcSet, FrameMeasurement, RimQuality, RimSet, SunTilt
from craternav_fg.trajectory import InitialState, Trajectory

START_NS = 1_403_636_579_763_555_584
FRAMES_NS = START_NS + np.array([0, 200_000_001, 400_000_000])


@dataclass
class Folder:
    """A data set that a test may spoil."""

    path: Path

    def edit(self, name: str, old: str, new: str, count: int = 1) -> None:
        text = (self.path / name).read_text()
        assert old in text
        (self.path / name).write_text(text.replace(old, new, count))

    def edit_line(self, name: str, line: int, change: Any) -> None:
        lines = (self.path / name).read_text().splitlines()
        lines[line - 1 : line] = change(lines[line - 1].split(","))
        (self.path / name).write_text("\n".join(lines) + "\n")


def recording(rng: np.random.Generator) -> Recording:
    """Without images and measurements; numbers as awkward as they come."""
    body = Body('Moon "test"', 1737400.0, 4.902800118e12, (1e-7, -2e-9, 2.6616995e-6))
    bTc = frames.pose(frames.rotation_exp(rng.standard_normal(3)), rng.standard_normal(3))
    n = 41
    stamps = START_NS + 10_000_000 * np.arange(1, n + 1, dtype=np.int64)
    imu = ImuLog(stamps, rng.standard_normal((n, 3)) * 1e-5, rng.standard_normal((n, 3)))
    R = frames.rotation_exp(rng.standard_normal((3, 3)))
    gTb = np.stack([frames.pose(R[k], np.array([1.75e6, 3e3, -2e3]) + k) for k in range(3)])
    vectors = frames.up(np.array([0.1, 0.1001]), np.array([0.3, 0.3002]))
    return Recording(
        body=body,
        camera=Camera(64, 48, 71.3, 71.1, 31.1, 24.7, bTc),
        catalog=Catalog(
            identifiers=("A-1", "B, the second"),
            latitude_rad=np.array([0.01, -0.02]),
            longitude_rad=np.array([0.3, 0.31]),
            semi_major_m=np.array([1234.5, 900.1]),
            semi_minor_m=np.array([1000.3, 900.1]),
            angle_rad=np.array([0.7, 0.0]),
            height_m=np.array([12.3, -45.6]),
            body=body,
        ),
        imu=imu,
        imu_noise=ImuNoise(2e-5, 3.4e-4, 1e-9, 4e-6),
        initial=InitialState(
            START_NS, gTb[0], rng.standard_normal(3), 0.4, 4000.0, 5.0, 0.09, 4.8e-6, 2.9e-3
        ),
        sun=SunVectors(FRAMES_NS[[0, 2]], vectors),
        stamps_ns=FRAMES_NS,
        truth=Trajectory(FRAMES_NS, gTb, rng.standard_normal((3, 3)), rng.standard_normal((3, 6)) * 1e-5),
    )


def random_images(rng: np.random.Generator) -> list[Any]:
    return [rng.integers(0, 256, (48, 64), dtype=np.uint8) for _ in FRAMES_NS]


def random_measurements(rng: np.random.Generator) -> tuple[FrameMeasurement, ...]:
    """Three frames with 0, 1 and 2 rims; the first two have an arc, the last all that rims can have."""
    out = []
    for k, stamp in enumerate(FRAMES_NS.tolist()):
        root = rng.standard_normal((k, 5, 18)) * 1e-3
        rims = RimSet(np.arange(k), 0.1 * rng.standard_normal((k, 5)), root @ np.swapaxes(root, 1, 2))
        if k == 2:
            # The first columns of the root are the correlated parts.
            quality = RimQuality(*rng.uniform(0.0, 1.0, (5, 2)))
            correlated, shared = root[:, :, :5].copy(), root[:, :, 5:13].copy()
            fused = 2.0 * root[:, :, 13:] @ np.swapaxes(root[:, :, 13:], 1, 2)
            rims = replace(rims, quality=quality, correlated=correlated, shared=shared, fused_white=fused)
        sun = None if k == 1 else SunTilt(-3.0, 0.17, rng.standard_normal(2), rng.standard_normal(3))
        arcs = ArcSet.empty()
        if k < 2:
            points = tuple(0.1 * rng.standard_normal((m, 2)) for m in (3 + k,))
            sigmas = tuple(rng.uniform(1e-4, 1e-3, len(one)) for one in points)
            sigma, roots = np.array([2e-4]), rng.standard_normal((1, 5, 8)) * 1e-3
            arcs = ArcSet(np.array([1]), points, sigmas, sigma if k else None, roots if k else None)
        out.append(FrameMeasurement(stamp, rims, sun, arcs))
    return tuple(out)
