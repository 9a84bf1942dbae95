"""Detect the rims of a mosaic of any size: window by window, each kept in the folder when it is done."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.catalogs.image_projection import (
    ImageProjection,
    ground_rims,
    has_coordinates,
    read_projection,
)
from craternav_fg.catalogs.store import write_parquet
from craternav_fg.dataset.ellipses import write_detected_ellipses
from craternav_fg.dataset.foreign_images import MAX_PIXELS
from craternav_fg.detection.folder import WINDOWS, DetectionFolder, source_of
from craternav_fg.detection.images import Progress, Where
from craternav_fg.detection.raster import raster_size, read_window
from craternav_fg.detection.settings import DetectionSettings
from craternav_fg.detection.windows import WindowResult, WindowTask, detect_in_window, read_found
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.plots.detections import write_overlay
from craternav_fg.vision.detect import FoundRims
from craternav_fg.vision.mosaic import (
    MAX_RADIUS_SHARE,
    Window,
    core_side_px,
    merged_rims,
    mosaic_windows,
    pooled_suns,
)
from craternav_fg.workers import MAX_WORKER_DEATHS, Workers, cluster, each_result, processes

TABLE, CATALOG, OVERLAY = "rims.csv", "catalog.parquet", "overlay.png"
# Longest side of the overlay, and smallest radius drawn, px of it.
_OVERLAY_PX, _MIN_DRAWN_PX = 3000, 2.0
# Length of the mean of directions below which they have none in common.
_MIN_AGREEMENT = 0.5


@dataclass(frozen=True)
class MosaicResult:
    """What was found in a mosaic.

    Attributes
    ----------
    rims : FoundRims
        In px of the mosaic, the best first.
    craters : int or None
        Number of craters in the catalogue; None where the mosaic has no coordinates.
    windows : int
        Number of windows, of all levels.
    errors : tuple of str
        Windows that could not be read.
    undecided : int
        Windows of the finest level with rims whose direction towards the sun is not known.
    contradicted : int
        Windows whose craters contradict the direction that was given.
    """

    rims: FoundRims
    craters: int | None
    windows: int
    errors: tuple[str, ...]
    undecided: int
    contradicted: int


def is_mosaic(path: Path) -> bool:
    """Return whether an image is to be read in windows: it has coordinates, or is too large for one array.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
        False for what rasterio cannot read; other readers say why, if they cannot, either.
    """
    try:
        height, width = raster_size(path)
        return height * width > MAX_PIXELS or has_coordinates(path)
    except CraternavError:
        return False


def detect_mosaic(
    path: Path,
    folder: Path,
    settings: DetectionSettings,
    where: Where,
    *,
    body: Body | None = None,
    force: bool = False,
    progress: Progress | None = None,
    core_px: int | None = None,
) -> MosaicResult:
    """Detect the rims of a mosaic; windows that are done already are passed over.

    The folder gets rims.csv, as `craternav detect` writes it for an image, overlay.png, a reduced copy with
    the rims that are large enough to be seen there, and catalog.parquet if the mosaic has coordinates.

    Parameters
    ----------
    path : Path
        Image that rasterio reads.
    folder : Path
        New, empty, or of the same detection.
    settings : DetectionSettings
    where : Where
    body : Body, optional
        Body of the mosaic; without it that of its coordinates.
    force : bool
        Replace all results of the folder, whatever their options.
    progress : callable, optional
    core_px : int, optional
        Side of the windows' cores; without it `vision.mosaic.core_side_px`.

    Returns
    -------
    MosaicResult

    Raises
    ------
    InputError
        When the mosaic cannot be read, is too small, or its coordinates are not of the body, or the folder
        has other results or cannot be written.
    CraternavError
        When rasterio is not installed, the scheduler cannot be reached or is lost, or no window can be read.
        Finished windows are kept.
    """
    size = raster_size(path)
    projection = read_projection(path, body)
    if projection is None and body is not None:
        raise InputError(path, f"expected coordinates on {body.name or 'the body'}, found none")
    core_px = core_px or core_side_px(*size)
    levels = mosaic_windows(*size, settings.min_radius_px, core_px)
    if not levels:
        most = MAX_RADIUS_SHARE * min(size)
        raise InputError(
            path,
            f"{size[1]} x {size[0]} px are too small: the largest radius searched is {most:g} px, the "
            f"smallest {settings.min_radius_px:g} px",
        )
    identity = {"kind": "mosaic", "source": source_of(path), "core_px": core_px, **settings.identity()}
    store = DetectionFolder(folder, identity, force=force)
    with ExitStack() as stack:
        workers = None if where.scheduler is None else stack.enter_context(cluster(where.scheduler))
        scratch = stack.enter_context(store.open())
        if workers is None:
            workers = stack.enter_context(processes(where.workers, scratch))
        run = _Run(path, size, settings, store, workers, progress, sum(map(len, levels)))
        found = _all_levels(run, levels, settings.sun_rad)
        if not found:
            raise CraternavError(run.errors[0])
        rims = merged_rims([part for _, part in found])
        craters = None if projection is None else _write_catalog(store, path, projection, rims)
        write_detected_ellipses(folder / TABLE, rims.ellipses_px, rims.traced, path.name)
        _write_overlay(folder / OVERLAY, path, size, rims)
    finest = [part for window, part in found if window.level == levels[0][0].level and len(part)]
    return MosaicResult(
        rims, craters, sum(map(len, levels)), tuple(run.errors),
        sum(bool(np.isnan(part.sun_angle_rad)) for part in finest),
        sum(part.sun_contradicted for part in finest) if settings.sun_deg is not None else 0,
    )  # fmt: skip


class _Run:
    """Detects in windows on workers, and keeps what was found in the folder."""

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        settings: DetectionSettings,
        store: DetectionFolder,
        workers: Workers,
        progress: Progress | None,
        total: int,
    ) -> None:
        self._path, self._size, self._settings = path, size, settings
        self._store, self._workers, self._progress = store, workers, progress
        self._total, self._done = total, 0
        self.errors: list[str] = []

    def detect(
        self, suns: Mapping[Window, float | None], *, again: bool = False
    ) -> dict[Window, FoundRims | None]:
        """Detect in windows with these directions towards the sun; None for those that cannot be read."""
        self._total += len(suns) if again else 0
        tasks = {
            window.name: WindowTask(str(self._path), self._size, window, sun_rad, self._settings)
            for window, sun_rad in suns.items()
        }
        missing = {name: task for name, task in tasks.items() if self._read(task) is None}
        self._count(len(tasks) - len(missing))

        def died(name: str) -> WindowResult:
            problem = f"{self._path}: {name}: its worker died {MAX_WORKER_DEATHS} times: too little memory?"
            return WindowResult(name, error=problem)

        for result in each_result(self._workers, detect_in_window, missing, died, "windows"):
            if result.error is None:
                self._store.write(f"{WINDOWS}/{result.name}", result.content)
            else:
                self.errors.append(result.error)
            self._count(1)
        return {window: self._read(tasks[window.name]) for window in suns}

    def _read(self, task: WindowTask) -> FoundRims | None:
        return read_found(self._store.path / WINDOWS / task.name, task.sun_rad)

    def _count(self, done: int) -> None:
        self._done += done
        if self._progress is not None:
            self._progress("windows", self._done, self._total)


def _all_levels(
    run: _Run, levels: Sequence[Sequence[Window]], sun_rad: float | None
) -> list[tuple[Window, FoundRims]]:
    """Detect at all levels; the finest ones show where the sun is."""
    finest = run.detect(dict.fromkeys(levels[0], sun_rad))
    suns = dict.fromkeys(levels[0], sun_rad)
    if sun_rad is None:
        windows = [window for window, rims in finest.items() if rims is not None]
        rims = [found for found in finest.values() if found is not None]
        own = np.array([found.sun_angle_rad for found in rims])
        pooled = pooled_suns(windows, own, np.array([found.sun_probability for found in rims]))
        suns = {
            w: None if np.isnan(angle) else float(angle) for w, angle in zip(windows, pooled, strict=True)
        }
        other = ~np.isnan(pooled) & ~(pooled == own)
        # What an empty window would be lit from does not matter.
        again = {windows[k]: suns[windows[k]] for k in np.flatnonzero(other) if _worth(rims[k])}
        finest |= run.detect(again, again=True)
    coarser = {window: _common_sun(window, suns, sun_rad) for level in levels[1:] for window in level}
    found = finest | run.detect(coarser)
    return [(window, rims) for window, rims in found.items() if rims is not None]


def _worth(rims: FoundRims) -> bool:
    """Whether a window has anything that another direction towards the sun may change."""
    return len(rims) > 0 or not np.isnan(rims.sun_probability)


def _common_sun(window: Window, suns: Mapping[Window, float | None], sun_rad: float | None) -> float | None:
    """Direction towards the sun in a window of a coarser level; None where it has no common one."""
    if sun_rad is not None:
        return sun_rad
    here = [window.step * side for side in window.outer]
    seen = [
        angle
        for one, angle in suns.items()
        if angle is not None and _meet(here, [one.step * side for side in one.core])
    ]
    mean = complex(np.mean(np.exp(1j * np.array(seen)))) if seen else 0.0
    return float(np.angle(mean)) if abs(mean) > _MIN_AGREEMENT else None


def _meet(one: Sequence[int], other: Sequence[int]) -> bool:
    """Whether two boxes (left, top, right, bottom) overlap."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _write_catalog(store: DetectionFolder, path: Path, projection: ImageProjection, rims: FoundRims) -> int:
    """Write the rims that lie on the body as a catalogue; none when there are none."""
    target = store.path / CATALOG
    ground = ground_rims(projection, rims.charts_px, rims.covariance_px, path.stem)
    if not len(ground.catalog):
        target.unlink(missing_ok=True)
        return 0
    of = rims.take(ground.rows)
    beside = {
        "quality": of.quality, "traced": of.traced, "source": np.full(len(of), path.name),
        "chart_covariance": ground.covariance.reshape(-1, 25),
        "x_px": of.charts_px[:, 0], "y_px": of.charts_px[:, 1],
    }  # fmt: skip
    write_parquet(target, ground.catalog, beside)
    return len(ground.catalog)


def _write_overlay(target: Path, path: Path, size: tuple[int, int], rims: FoundRims) -> None:
    """Draw the larger rims on a reduced copy; not if the mosaic is damaged, which its windows have told."""
    level = max(int(np.ceil(np.log2(max(size) / _OVERLAY_PX))), 0)
    whole = (0, 0, size[1] >> level, size[0] >> level)
    window = Window(level, 0, 0, whole, whole, (0.0, 0.0))
    try:
        pixels = read_window(path, window)
    except InputError:
        target.unlink(missing_ok=True)
        return
    shown = rims.take(rims.ellipses_px[:, 2] >= _MIN_DRAWN_PX * window.step)
    ellipses = shown.ellipses_px.copy()
    ellipses[:, :2] = (ellipses[:, :2] + 0.5) / window.step - 0.5
    ellipses[:, 2:4] /= window.step
    write_overlay(target, pixels.values, replace(shown, ellipses_px=ellipses))
