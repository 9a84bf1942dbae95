"""Detection in one window of a mosaic, and the file that keeps what was found."""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from craternav_fg.detection.raster import read_window
from craternav_fg.detection.settings import DetectionSettings, use_one_thread
from craternav_fg.ellipse import axes_of_chart
from craternav_fg.errors import CraternavError
from craternav_fg.files import SizeLimit, read_bytes
from craternav_fg.vision.detect import FoundRims
from craternav_fg.vision.mosaic import Window, kept_rims, window_options

_NAN = float("nan")


@dataclass(frozen=True)
class WindowTask:
    """What a worker gets.

    Attributes
    ----------
    path : str
        Image.
    size : tuple of int
        Its height and width.
    window : Window
    sun_rad : float, optional
        Direction towards the sun, if it is known.
    settings : DetectionSettings
    """

    path: str
    size: tuple[int, int]
    window: Window
    sun_rad: float | None
    settings: DetectionSettings

    @property
    def name(self) -> str:
        """Name of the file that keeps what was found."""
        return f"{self.window.name}{'' if self.sun_rad is None else '_sun'}.npz"


@dataclass(frozen=True)
class WindowResult:
    """What a worker gives back.

    Attributes
    ----------
    name : str
        See `WindowTask`.
    content : bytes
        Of the file that keeps it.
    error : str or None
        Why there is none.
    """

    name: str
    content: bytes = b""
    error: str | None = None


def detect_in_window(task: WindowTask) -> WindowResult:
    """Detect the rims that a window is responsible for; a worker calls this.

    Parameters
    ----------
    task : WindowTask

    Returns
    -------
    WindowResult
    """
    use_one_thread()
    try:
        pixels = read_window(Path(task.path), task.window)
        if not pixels.known.any():
            return WindowResult(task.name, _content(_none(), task.sun_rad))
        options = window_options(task.window, task.settings.options())
        rims = task.settings.detect(pixels.values, task.sun_rad, options)
        kept = kept_rims(rims, pixels.known, task.window, task.size)
    except CraternavError as error:
        return WindowResult(task.name, error=str(error))
    except MemoryError:
        return WindowResult(task.name, error=f"{task.path}: too little memory for {task.window.name}")
    return WindowResult(task.name, _content(kept, task.sun_rad))


def _none() -> FoundRims:
    empty = np.empty(0)
    return FoundRims(
        np.empty((0, 5)), np.empty((0, 5)), np.empty((0, 5, 5)), empty, empty.astype(np.bool_), empty, _NAN
    )


def _content(rims: FoundRims, sun_rad: float | None) -> bytes:
    given = _NAN if sun_rad is None else sun_rad
    stream = io.BytesIO()
    np.savez(
        stream, charts_px=rims.charts_px, covariance_px=rims.covariance_px, quality=rims.quality,
        traced=rims.traced, local_sun_angles_rad=rims.local_sun_angles_rad,
        sun=np.array([given, rims.sun_angle_rad, rims.seen_sun_angle_rad, rims.sun_probability]),
    )  # fmt: skip
    return stream.getvalue()


def read_found(path: Path, sun_rad: float | None) -> FoundRims | None:
    """Read what was found in a window.

    Parameters
    ----------
    path : Path
    sun_rad : float, optional
        Direction towards the sun with which it must have been detected.

    Returns
    -------
    FoundRims or None
        In px of the mosaic; None when the file is missing, damaged, or of another direction.
    """
    try:
        with np.load(io.BytesIO(read_bytes(path, SizeLimit.ARCHIVE)), allow_pickle=False) as found:
            given, angle, seen, probability = (float(value) for value in found["sun"])
            if not np.array_equal(given, _NAN if sun_rad is None else sun_rad, equal_nan=True):
                return None
            charts = found["charts_px"]
            return FoundRims(
                axes_of_chart(charts), charts, found["covariance_px"], found["quality"], found["traced"],
                found["local_sun_angles_rad"], angle, seen, probability,
            )  # fmt: skip
    except (CraternavError, OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
