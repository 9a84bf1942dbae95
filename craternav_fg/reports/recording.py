"""A run as a recording for the rerun viewer: trajectories over the crater map, frames with their rims."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.compute as pc

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import points_on
from craternav_fg.errors import CraternavError
from craternav_fg.files import replacing
from craternav_fg.plots.style import colour
from craternav_fg.reports.crater_map import near_track, outlines
from craternav_fg.runs.columns import list_values
from craternav_fg.runs.read import Run, read_residuals
from factors.arrays import FloatArray

# Craters within this multiple of the highest altitude from the track are in the recording.
_REACH_ALTITUDES = 4.0
JPEG_QUALITY = 85
# Of measured rims and of the catalogue's.
YELLOW, GREY = (240, 228, 66), (140, 140, 140)
# Points that draw a rim of the catalogue, and one in an image.
_MAP_POINTS, _IMAGE_POINTS = 48, 72


def write_recording(run: Run, path: Path) -> None:
    """Write a run as a `.rrd` file for the rerun viewer.

    The scene is in local level axes at the first estimate's ground point: x east, y north, z up, km. The
    first estimator of the run carries the camera; each frame's image is shown with its measured rims.

    Parameters
    ----------
    run : Run
    path : Path

    Raises
    ------
    CraternavError
        When the extra `viewer` is not installed.
    InputError
        When the run's data set cannot be read, or `path` cannot be written.
    """
    try:
        import rerun as rr
    except ImportError:
        raise CraternavError("recordings need rerun: pip install 'craternav_fg[viewer]'") from None
    dataset = Dataset.open(run.dataset)
    first = next(iter(run.trajectories.values()))
    gRe, gO = local_level(run, dataset)

    def local_km(gP: FloatArray) -> FloatArray:
        return 1e-3 * (gP - gO) @ gRe

    with replacing(path) as temporary:
        recording = rr.RecordingStream("craternav_fg", recording_id=run.path.resolve().name)
        recording.save(temporary)
        recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rims = catalogue_rims(run, dataset)
        recording.log("world/craters", rr.LineStrips3D(list(local_km(rims)), colors=[GREY]), static=True)
        lines = {name: (t, colour(name)) for name, t in run.trajectories.items()}
        if run.truth is not None:
            lines["truth"] = (run.truth, "#FFFFFF")
        for name, (trajectory, hue) in lines.items():
            rgb = tuple(int(hue[k : k + 2], 16) for k in (1, 3, 5))
            strip = rr.LineStrips3D([local_km(trajectory.gP)], colors=[rgb])
            recording.log(f"world/trajectories/{name}", strip, static=True)
        _log_frames(rr, recording, run, dataset, local_km(first.gP), gRe)
        recording.flush()
        recording.disconnect()


def _log_frames(
    rr: Any, recording: Any, run: Run, dataset: Dataset, position_km: FloatArray, gRe: FloatArray
) -> None:
    """Log pose, camera, image and measured rims of each frame at its time."""
    name, trajectory = next(iter(run.trajectories.items()))
    camera = dataset.camera
    table = read_residuals(run.path)
    own = table.filter(pc.equal(table["estimator"], name))
    stamps = own["stamp_ns"].to_numpy()
    charts = list_values(own["chart"])
    assert charts is not None
    identifiers = np.array(own["crater_id"].to_pylist())
    lander = "world/lander"
    pinhole = rr.Pinhole(
        focal_length=[camera.fx_px, camera.fy_px], principal_point=[camera.cx_px, camera.cy_px],
        resolution=[camera.width_px, camera.height_px],
        camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=2.0,
    )  # fmt: skip
    recording.log(
        f"{lander}/camera",
        rr.Transform3D(translation=1e-3 * camera.bTc[:3, 3], mat3x3=camera.bTc[:3, :3]),
        static=True,
    )
    recording.log(f"{lander}/camera/image", pinhole, static=True)
    for k, stamp in enumerate(trajectory.stamps_ns.tolist()):
        recording.set_time("time", duration=1e-9 * (stamp - int(trajectory.stamps_ns[0])))
        attitude = gRe.T @ trajectory.gRb[k]
        recording.log(lander, rr.Transform3D(translation=position_km[k], mat3x3=attitude))
        if dataset.measurements is None:
            image = dataset.image(k)
            grey = (255.0 / camera.full_scale * image).astype(np.uint8)
            _, coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            recording.log(
                f"{lander}/camera/image", rr.EncodedImage(contents=coded.tobytes(), media_type="image/jpeg")
            )
        rows = stamps == stamp
        measured = camera.pixels(points_on(charts[rows], _IMAGE_POINTS))
        measured = np.concatenate([measured, measured[:, :1]], axis=1)
        recording.log(
            f"{lander}/camera/image/rims",
            rr.LineStrips2D(list(measured), colors=[YELLOW], labels=identifiers[rows].tolist()),
        )


def local_level(run: Run, dataset: Dataset) -> tuple[FloatArray, FloatArray]:
    """Return the local level axes of a recording: east, north, up at the first estimate's ground point.

    Parameters
    ----------
    run : Run
    dataset : Dataset

    Returns
    -------
    gRe : ndarray, shape (3, 3)
        Rotation from the level axes to g.
    gO : ndarray, shape (3,)
        Ground point in g, m.
    """
    first = next(iter(run.trajectories.values())).gP[0]
    lat, lon = frames.latitude_longitude(first)
    return frames.east_north_up(lat, lon), first * (dataset.body.radius_m / np.linalg.norm(first))


def catalogue_rims(run: Run, dataset: Dataset) -> FloatArray:
    """Outline the catalogue's rims along the track of a run's first estimator.

    Parameters
    ----------
    run : Run
    dataset : Dataset

    Returns
    -------
    ndarray, shape (n, points, 3)
        Closed outlines in g, m.
    """
    first = next(iter(run.trajectories.values()))
    rows = near_track(dataset.catalog, first, dataset.body, _REACH_ALTITUDES)
    return outlines(dataset.catalog, rows, _MAP_POINTS + 1)
