"""What all frames measured, on disk in place of images: rims and arcs (see `rim_files`) and sun tilts."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import layout
from craternav_fg.dataset.rim_files import read_arcs, read_rims, write_arcs, write_rims
from craternav_fg.dataset.sun import SunVectors
from craternav_fg.errors import InputError
from craternav_fg.files import exists
from craternav_fg.measurements import ArcSet, FrameMeasurement, SunTilt
from craternav_fg.tables import read_table, write_table
from factors.arrays import FloatArray, IntArray


def ground_sun_direction(
    sun: FloatArray, catalog: Catalog, craters: IntArray, prior_gP: FloatArray
) -> FloatArray:
    """Project the direction towards the sun onto the ground of a frame: a measured sun tilt is its image.

    It depends only on what the lander knows, not on its true position.

    Parameters
    ----------
    sun : ndarray, shape (3,)
        Unit vector towards the sun in g.
    catalog : Catalog
    craters : ndarray of int, shape (n,)
        Rows of the craters in the frame: the ground's normal is that at the mean of their centres.
    prior_gP : ndarray, shape (3,)
        Position of the initial state in g, m: without craters the normal is that below it.

    Returns
    -------
    ndarray, shape (3,)
        s - (s.n) n in g; not a unit vector.
    """
    normal = catalog.centres[craters].mean(axis=0) if len(craters) else prior_gP
    normal = normal / np.linalg.norm(normal)
    return np.asarray(sun - (sun @ normal) * normal)


def write_measurements(folder: Path, frames: Sequence[FrameMeasurement], catalog: Catalog) -> None:
    """Write all that frames measured: `rims.parquet`, `sun_tilts.csv` and, if there are arcs, `arcs.parquet`.

    Parameters
    ----------
    folder : Path
        Folder of the data set; it must exist.
    frames : sequence of FrameMeasurement
    catalog : Catalog
        Catalogue of the rims' craters.

    Raises
    ------
    InputError
        When a file cannot be written.
    """
    write_rims(folder / layout.RIMS, frames, catalog)
    if any(len(frame.arcs) for frame in frames):
        write_arcs(folder / layout.ARCS, frames, catalog)
    else:
        (folder / layout.ARCS).unlink(missing_ok=True)
    tilts = [(frame.stamp_ns, frame.sun) for frame in frames if frame.sun is not None]
    values = np.array([[t.tilt_rad, t.sigma_rad, *t.point, *t.direction] for _, t in tilts]).reshape(-1, 7)
    stamps = [stamp for stamp, _ in tilts]
    write_table(folder / layout.TILTS, layout.TILT_COLUMNS, [stamps, *values.T], comment=True)


def read_measurements(
    folder: Path,
    stamps_ns: IntArray,
    catalog: Catalog,
    camera: Camera,
    sun: SunVectors,
    prior_gP: FloatArray | None,
) -> tuple[FrameMeasurement, ...]:
    """Read what `write_measurements` wrote: one measurement per frame.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames, increasing.
    catalog : Catalog
    camera : Camera
    sun : SunVectors
    prior_gP : ndarray, shape (3,), or None
        Position of the initial state in g, m. It gives the direction of sun tilts whose file has none, see
        `ground_sun_direction`; without it such tilts are left out in frames without rims, where nothing else
        tells the ground's normal.

    Returns
    -------
    tuple of FrameMeasurement, length k

    Raises
    ------
    InputError
        For a table of another form, unknown stamps or craters, a crater twice in a frame, values out of
        range, rims outside the image, and matrices that are not covariances.
    """
    rims = read_rims(folder / layout.RIMS, stamps_ns, catalog, camera)
    arcs = [ArcSet.empty()] * len(stamps_ns)
    if exists(folder / layout.ARCS):
        arcs = read_arcs(folder / layout.ARCS, stamps_ns, catalog, camera)
    for stamp, whole, part in zip(stamps_ns, rims, arcs, strict=True):
        both = np.intersect1d(whole.craters, part.craters)
        if len(both):
            problem = f"{catalog.identifiers[both[0]]!r} is in {layout.RIMS} at {stamp}, too"
            raise InputError(folder / layout.ARCS, problem, column="crater_id")
    tilts = _read_tilts(folder / layout.TILTS, stamps_ns)
    out = []
    for k, stamp in enumerate(stamps_ns.tolist()):
        tilt = tilts.get(k)
        if tilt is not None and not tilt.direction.any():
            tilt = _with_direction(tilt, sun.at(stamp), catalog, rims[k].craters, prior_gP)
        out.append(FrameMeasurement(stamp, rims[k], tilt, arcs[k]))
    return tuple(out)


def _with_direction(
    tilt: SunTilt, sun: FloatArray, catalog: Catalog, craters: IntArray, prior_gP: FloatArray | None
) -> SunTilt | None:
    """Set the direction of a tilt; None when the ground's normal is not known."""
    if prior_gP is None:
        if not len(craters):
            return None
        prior_gP = np.zeros(3)
    return replace(tilt, direction=ground_sun_direction(sun, catalog, craters, prior_gP))


def _read_tilts(path: Path, frames_ns: IntArray) -> dict[int, SunTilt]:
    """Tilts of the frames that have them, by frame index; their direction is zero when the file has none."""
    if not exists(path):
        return {}
    table = read_table(path, layout.TILT_COLUMNS)
    table.require_increasing(layout.STAMP)
    sigma_rad = table.columns[layout.TILT[1]]
    bad = np.flatnonzero(sigma_rad <= 0.0)
    if len(bad):
        table.fail(int(bad[0]), layout.TILT[1], f"expected more than 0, found {sigma_rad[bad[0]]}")
    stamps = table.columns[layout.STAMP]
    frames = np.minimum(np.searchsorted(frames_ns, stamps), len(frames_ns) - 1)
    for row in np.flatnonzero(frames_ns[frames] != stamps).tolist():
        table.fail(row, layout.STAMP, f"{stamps[row]} is no stamp of {layout.CAMERA_DATA}")
    directions = np.zeros((len(table), 3))
    given = [name for name in layout.TILT_DIRECTION if name in table.columns]
    if given:
        missing = [name for name in layout.TILT_DIRECTION if name not in given]
        if missing:
            raise InputError(path, f"column is missing beside {given[0]}", column=missing[0])
        directions = table.numbers(*layout.TILT_DIRECTION)
        for row in np.flatnonzero(~directions.any(axis=1)).tolist():
            table.fail(row, layout.TILT_DIRECTION[0], "expected a direction, found zero")
    values = table.numbers(*layout.TILT, *layout.TILT_POINT)
    numbers = zip(frames.tolist(), values, directions, strict=True)
    return {k: SunTilt(float(t), float(s), np.array([x, y]), d) for k, (t, s, x, y), d in numbers}
