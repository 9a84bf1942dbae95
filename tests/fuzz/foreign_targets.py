"""Files of other programs: images, elevation models, ISIS cubes, SPICE kernels, bags, Kalibr's YAML."""

from pathlib import Path

import cv2
import numpy as np
import rasterio

from craternav_fg.catalogs.files import write_catalog
from craternav_fg.dataset import Dataset, write_dataset
from craternav_fg.dataset.sensor_files import camera_yaml
from craternav_fg.interchange.bag_export import BagFormat, export_bag
from craternav_fg.interchange.kalibr import camchain_yaml, kalibr_imu_yaml
from tests.dataset.samples import random_images, recording
from tests.fuzz.target import Target
from tests.importing.cubes import write_cube
from tests.importing.kernels import write_kernels
from tests.importing.moon import moon_catalog
from tests.interchange.test_bags import name_of

# A crater as a detector sees it: a bright and a dark side.
_SIDE_PX, _RADIUS_PX = 96, 20.0


def foreign_targets(folder: Path) -> dict[str, Target]:
    """Make one sound example of each format."""
    return {
        "images": _images(folder / "images"),
        "elevation": _elevation(folder / "elevation"),
        "cubes": _cubes(folder / "cubes"),
        "kernels": _kernels(folder / "kernels"),
        "bags": _bags(folder / "bags"),
    }


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _images(folder: Path) -> Target:
    folder.mkdir()
    y, x = np.mgrid[:_SIDE_PX, :_SIDE_PX] - 0.5 * _SIDE_PX
    r = np.hypot(x, y) / _RADIUS_PX
    grey = (
        120.0 + 60.0 * x / _RADIUS_PX * np.exp(-(r**8)) + np.random.default_rng(1).normal(0.0, 2.0, x.shape)
    )
    bytes_, words = grey.astype(np.uint8), (100.0 * grey).astype(np.uint16)
    names = ("8.png", "8.jpg", "8.tif", "8.bmp", "16.png", "16.tif")
    for name in names:
        cv2.imwrite(str(folder / name), words if name.startswith("16") else bytes_)
    cv2.imwrite(str(folder / "colour.png"), np.dstack([bytes_] * 3))
    return Target(
        folder,
        _files,
        lambda here: [["detect", str(path), "-o", f"{here}/rims.csv"] for path in _files(here)],
    )


def _elevation(folder: Path) -> Target:
    folder.mkdir()
    catalog = recording(np.random.default_rng(1)).catalog
    write_catalog(folder / "craters.csv", catalog)
    heights = np.random.default_rng(2).normal(0.0, 100.0, (1, 90, 180)).astype(np.float32)
    crs = f"+proj=longlat +R={catalog.body.radius_m} +no_defs"
    for name, more in (("plain.tif", {}), ("tiled.tif", {"tiled": True, "compress": "deflate"})):
        with rasterio.open(
            folder / name, "w", driver="GTiff", height=90, width=180, count=1, dtype="float32", crs=crs,
            transform=rasterio.Affine(2.0, 0.0, -180.0, 0.0, -2.0, 90.0), **more,
        ) as raster:  # fmt: skip
            raster.write(heights)

    def commands(here: Path) -> list[list[str]]:
        table = ["catalog", "import", f"{here}/craters.csv", "--body-radius-m", str(catalog.body.radius_m)]
        return [
            [*table, "-o", f"{here}/out.csv", "--dem", f"{here}/{name}"]
            for name in ("plain.tif", "tiled.tif")
        ]

    return Target(folder, _files, commands)


def _cubes(folder: Path) -> Target:
    folder.mkdir()
    write_catalog(folder / "craters.csv", moon_catalog())
    names = [f"{kind}.cub" for kind in ("Real", "UnsignedByte")]
    for k, name in enumerate(names):
        start = f"2000-01-01T12:00:{10 * k:02d}"
        write_cube(folder / name, kind=name.partition(".")[0], start=start, focal_mm=0.5)
    more = ["--catalog", "craters.csv", "-o", "data"]
    return Target(
        folder,
        _files,
        lambda here: [
            ["import", "isis", str(here / name), *(m if m.startswith("-") else str(here / m) for m in more)]
            for name in names
        ],
    )


def _given_images(folder: Path, rng: np.random.Generator) -> list[str]:
    """Write two images with their times, camera and catalogue; arguments that name them in {here}."""
    (folder / "sensor.yaml").write_text(camera_yaml(recording(rng).camera, 1.0))
    write_catalog(folder / "craters.csv", moon_catalog())
    for k in range(2):
        cv2.imwrite(str(folder / f"{k}.png"), rng.integers(0, 255, (48, 64), dtype=np.uint8))
    rows = [f"{k}.png,2000-01-01T12:00:{10 + k}" for k in range(2)]
    (folder / "times.csv").write_text("filename,utc\n" + "\n".join(rows) + "\n")
    return [
        "{here}/0.png", "{here}/1.png", "--camera", "{here}/sensor.yaml", "--catalog", "{here}/craters.csv",
        "--times", "{here}/times.csv", "-o", "{here}/data",
    ]  # fmt: skip


def _kernels(folder: Path) -> Target:
    folder.mkdir()
    given = _given_images(folder, np.random.default_rng(1))
    write_kernels(folder)
    names = ("naif.tls", "frames.tf", "orbit.bsp", "attitude.bc")
    # A copy has other paths than a meta-kernel would name.
    (folder / "all.tm").unlink()
    loaded = [part for name in names for part in ("--meta-kernel", f"{{here}}/{name}")]

    def commands(here: Path) -> list[list[str]]:
        spice = ["import", "spice", *given, *loaded, "--spacecraft", "-999", "--instrument-frame", "CAM"]
        plain = ["import", "images", *given, "--sun", "0,3,4"]
        return [[part.replace("{here}", str(here)) for part in command] for command in (spice, plain)]

    return Target(folder, _files, commands)


def _bags(folder: Path) -> Target:
    folder.mkdir()
    rng = np.random.default_rng(3)
    write_dataset(folder / "data", recording(rng), random_images(rng))
    data = Dataset.open(folder / "data")
    assert data.imu_noise is not None
    for kind in BagFormat:
        (folder / kind).mkdir()
        export_bag(data, name_of(folder / kind, kind), kind, compressed=kind == "rosbag2")
    (folder / "camchain.yaml").write_text(camchain_yaml(data.camera, "/cam0/image_raw"))
    (folder / "imu.yaml").write_text(kalibr_imu_yaml(data.imu_noise, 100.0, "/imu0"))

    def commands(here: Path) -> list[list[str]]:
        more = [
            "--description", f"{here}/data/dataset.toml", "--catalog", f"{here}/data/craters.csv", "--imu",
            f"{here}/imu.yaml", "-o", f"{here}/out",
        ]  # fmt: skip
        bags = [["import", "bag", str(name_of(here / kind, kind)), *more] for kind in BagFormat]
        yamls = [f"{here}/camchain.yaml", f"{here}/imu.yaml"]
        return [
            *([*bag, *camera] for bag in bags for camera in ([], ["--camera", yamls[0]])),
            *(["import", "kalibr", name, "-o", f"{here}/sensor.yaml"] for name in yamls),
        ]

    def files(here: Path) -> list[Path]:
        mav = here / "data" / "mav0"
        return [path for path in _files(here) if mav not in path.parents]

    return Target(folder, files, commands)
