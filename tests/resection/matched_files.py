"""Camera, catalogue and matched rims of one image, as files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.files import write_catalog
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.ellipse import matrix_of_chart, pixel_chart
from craternav_fg.resection.files import read_rims
from craternav_fg.resection.problem import MatchedRims
from factors.kernels.conic import project_rims

MOON = Body("Moon", 1737400.0, 4.9e12, (0.0, 0.0, 0.0))
# Unequal focal lengths and a mounting: mistakes in either show.
CAMERA = Camera(
    1024, 768, 1267.0, 1100.0, 500.0, 400.0,
    frames.pose(frames.rotation_exp(np.array([0.4, -0.3, 1.2])), np.array([1.2, -0.3, 0.8])),
)  # fmt: skip
HEADER = (
    "ellipseCenterX(px),ellipseCenterY(px),ellipseSemimajor(px),ellipseSemiminor(px),"
    "ellipseRotation(deg),CRATER_ID"
)


@dataclass(frozen=True)
class Files:
    """A camera, a catalogue and the rims of one image, on disk; and the true pose."""

    folder: Path
    gTb: np.ndarray
    rows: list[str]
    catalog: Catalog

    def rims(self, *rows: str, header: str = HEADER) -> Path:
        path = self.folder / "rims.csv"
        path.write_text("\n".join([header, *(rows or self.rows)]) + "\n")
        return path

    def arguments(self, rims: Path | None = None) -> list[str]:
        paths = (rims or self.rims(), "--camera", self.folder / "sensor.yaml")
        return ["pose", *map(str, paths), "--catalog", str(self.folder / "craters.csv")]

    def read(self, rims: Path) -> tuple[MatchedRims, Catalog]:
        path = self.folder / "craters.csv"
        return read_rims(rims, CAMERA, path, MOON, sigma_px=1.0, edge_points=60)[:2]


def make_files(folder: Path) -> Files:
    """Write the files of an image of four craters."""
    catalog = Catalog(
        identifiers=("01-a", "01-b", "01-c", "01-d"),
        latitude_rad=np.radians([0.0, 0.2, -0.25, 0.1]),
        longitude_rad=np.radians([23.0, 23.3, 23.2, 22.7]),
        semi_major_m=np.array([3000.0, 2500.0, 2200.0, 2600.0]),
        semi_minor_m=np.array([2500.0, 2400.0, 1500.0, 2000.0]),
        angle_rad=np.radians([20.0, 80.0, 130.0, -30.0]),
        height_m=np.array([100.0, -50.0, 0.0, 300.0]),
        body=MOON,
    )
    down = frames.east_north_up(np.radians(0.1), np.radians(23.0))
    gTc = frames.pose(
        down @ np.diag([1.0, -1.0, -1.0]) @ frames.rotation_exp(np.array([0.25, -0.2, 0.7])), np.zeros(3)
    )
    gTc[:3, 3] = catalog.centres.mean(axis=0) - 50e3 * gTc[:3, 2]
    gTb = np.ascontiguousarray(gTc @ frames.inverse(CAMERA.bTc))
    charts, seen = project_rims(gTb, CAMERA.bTc, catalog.centres, catalog.axes)
    assert seen.all()
    rows = []
    charts_px = pixel_chart(charts, CAMERA)
    for name, (x, y), S in zip(
        catalog.identifiers, charts_px[:, :2], matrix_of_chart(charts_px), strict=True
    ):
        values, vectors = np.linalg.eigh(S)
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        numbers = (x, y, np.sqrt(values[1]), np.sqrt(values[0]), angle)
        rows.append(",".join([*(repr(float(v)) for v in numbers), name]))
    (folder / "sensor.yaml").write_text(camera_yaml(CAMERA, 1.0))
    write_catalog(folder / "craters.csv", catalog)
    return Files(folder, gTb, rows, catalog)
