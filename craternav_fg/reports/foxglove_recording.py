"""A run as an MCAP recording with Foxglove's schemas: map, trajectories, camera, frames with their rims."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.compute as pc

from craternav_fg import frames, lens
from craternav_fg.camera import Camera
from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import points_on
from craternav_fg.errors import CraternavError
from craternav_fg.files import replacing
from craternav_fg.plots.style import colour
from craternav_fg.reports.recording import (
    GREY,
    JPEG_QUALITY,
    YELLOW,
    catalogue_rims,
    local_level,
)
from craternav_fg.runs.columns import list_values
from craternav_fg.runs.read import Run, read_residuals
from factors.arrays import FloatArray

# Names of frames: local level axes (east, north, up) at the first estimate's ground point, m; b; c.
MAP, LANDER, CAMERA = "map", "lander", "camera"
_IMAGE_POINTS = 72
_LENS_NAMES = {
    lens.RADIAL_TANGENTIAL: "plumb_bob",
    lens.RATIONAL: "rational_polynomial",
    lens.FISHEYE: "kannala_brandt",
}


def write_mcap(run: Run, path: Path) -> None:
    """Write a run as a `.mcap` file for Foxglove.

    The first estimator of the run carries the camera.

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
        import foxglove
    except ImportError:
        raise CraternavError("MCAP needs foxglove-sdk: pip install 'craternav_fg[viewer]'") from None
    dataset = Dataset.open(run.dataset)
    context = foxglove.Context()
    with (
        replacing(path) as temporary,
        foxglove.open_mcap(temporary, allow_overwrite=True, context=context),
    ):
        recording = _Recording(context)
        gRe, gO = local_level(run, dataset)
        recording.scene(run, dataset, gRe, gO)
        recording.frames(run, dataset, gRe, gO)


class _Recording:
    """Channels of a recording, and what is logged to them."""

    def __init__(self, context: Any) -> None:
        from foxglove import channels, messages

        self.messages = messages
        self.map = channels.SceneUpdateChannel("/map", context=context)
        self.transforms = channels.FrameTransformChannel("/tf", context=context)
        self.calibration = channels.CameraCalibrationChannel("/camera/calibration", context=context)
        self.image = channels.CompressedImageChannel("/camera/image", context=context)
        self.rims = channels.ImageAnnotationsChannel("/camera/rims", context=context)

    def scene(self, run: Run, dataset: Dataset, gRe: FloatArray, gO: FloatArray) -> None:
        """Log the craters near the trajectory, and all trajectories."""
        m = self.messages
        first = next(iter(run.trajectories.values()))
        rims = catalogue_rims(run, dataset)
        entities = [self._lines("craters", [(one - gO) @ gRe for one in rims], _rgb(GREY))]
        for name, trajectory in run.trajectories.items():
            entities.append(self._lines(name, [(trajectory.gP - gO) @ gRe], _hex(colour(name))))
        if run.truth is not None:
            entities.append(self._lines("truth", [(run.truth.gP - gO) @ gRe], (1.0, 1.0, 1.0)))
        self.map.log(m.SceneUpdate(entities=entities), log_time=int(first.stamps_ns[0]))

    def _lines(self, name: str, strips: list[FloatArray], rgb: tuple[float, float, float]) -> Any:
        m = self.messages
        lines = [
            m.LinePrimitive(
                type=m.LinePrimitiveLineType.LineStrip,
                thickness=2.0,
                scale_invariant=True,
                points=[m.Point3(x=x, y=y, z=z) for x, y, z in strip.tolist()],
                color=m.Color(r=rgb[0], g=rgb[1], b=rgb[2], a=1.0),
            )
            for strip in strips
        ]
        return m.SceneEntity(frame_id=MAP, id=name, lines=lines)

    def frames(self, run: Run, dataset: Dataset, gRe: FloatArray, gO: FloatArray) -> None:
        """Log pose, camera, image and measured rims of each frame at its stamp."""
        m, camera = self.messages, dataset.camera
        name, trajectory = next(iter(run.trajectories.items()))
        table = read_residuals(run.path)
        own = table.filter(pc.equal(table["estimator"], name))
        stamps, charts = own["stamp_ns"].to_numpy(), list_values(own["chart"])
        for k, stamp in enumerate(trajectory.stamps_ns.tolist()):
            time = m.Timestamp(sec=stamp // 1_000_000_000, nsec=stamp % 1_000_000_000)
            eTb = frames.pose(gRe.T @ trajectory.gRb[k], (trajectory.gP[k] - gO) @ gRe)
            for parent, child, T in ((MAP, LANDER, eTb), (LANDER, CAMERA, camera.bTc)):
                self.transforms.log(self._transform(time, parent, child, T), log_time=stamp)
            self.calibration.log(self._calibration(time, camera), log_time=stamp)
            if dataset.measurements is None:
                grey = (255.0 / camera.full_scale * dataset.image(k)).astype(np.uint8)
                _, coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
                picture = m.CompressedImage(
                    timestamp=time, frame_id=CAMERA, data=coded.tobytes(), format="jpeg"
                )
                self.image.log(picture, log_time=stamp)
            if charts is not None:
                outlines = camera.pixels(points_on(charts[stamps == stamp], _IMAGE_POINTS))
                self.rims.log(self._annotations(time, outlines), log_time=stamp)

    def _transform(self, time: Any, parent: str, child: str, T: FloatArray) -> Any:
        m = self.messages
        w, x, y, z = frames.to_quaternion_wxyz(T[:3, :3]).tolist()
        px, py, pz = T[:3, 3].tolist()
        return m.FrameTransform(
            timestamp=time, parent_frame_id=parent, child_frame_id=child,
            translation=m.Vector3(x=px, y=py, z=pz), rotation=m.Quaternion(x=x, y=y, z=z, w=w),
        )  # fmt: skip

    def _calibration(self, time: Any, camera: Camera) -> Any:
        return self.messages.CameraCalibration(
            timestamp=time, frame_id=CAMERA, width=camera.width_px, height=camera.height_px,
            distortion_model=_LENS_NAMES[camera.lens_model], D=[float(k) for k in camera.distortion],
            K=camera.matrix.ravel().tolist(), R=np.eye(3).ravel().tolist(),
            P=np.column_stack([camera.matrix, np.zeros(3)]).ravel().tolist(),
        )  # fmt: skip

    def _annotations(self, time: Any, outlines_px: FloatArray) -> Any:
        m = self.messages
        red, green, blue = _rgb(YELLOW)
        points = [
            m.PointsAnnotation(
                timestamp=time,
                type=m.PointsAnnotationType.LineLoop,
                points=[m.Point2(x=x, y=y) for x, y in outline.tolist()],
                outline_color=m.Color(r=red, g=green, b=blue, a=1.0),
                thickness=2.0,
            )
            for outline in outlines_px
        ]
        return m.ImageAnnotations(timestamp=time, points=points)


def _rgb(levels: tuple[int, int, int]) -> tuple[float, float, float]:
    return levels[0] / 255.0, levels[1] / 255.0, levels[2] / 255.0


def _hex(hue: str) -> tuple[float, float, float]:
    return _rgb((int(hue[1:3], 16), int(hue[3:5], 16), int(hue[5:7], 16)))
