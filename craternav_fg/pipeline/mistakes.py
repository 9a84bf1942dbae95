"""Usual mistakes in a data set whose images contradict its initial state: which one explains them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.filter_state import POSE
from craternav_fg.matching.acquire.search import acquire
from factors.arrays import FloatArray

# Craters that explain an image together; fewer may do so by chance.
_MIN_CRATERS = 5
# Images that are asked for one that shows anything: the range of its brightness as a share of full scale.
_MAX_IMAGES, _LEAST_CONTRAST = 20, 0.02
# How far from half a turn an attitude may be that shows images turned by 180 deg: as far as priors are wide.
_MAX_OFF_HALF_TURN_DEG = 40.0


@dataclass(frozen=True)
class _Corrected:
    """An image, its camera, catalogue and sun with a mistake undone; `what` completes "are found if ..."."""

    what: str
    image: ImageArray
    camera: Camera
    catalog: Catalog
    sun_g: FloatArray


def likely_mistake(
    dataset: Dataset, descent: Descent, report: Callable[[int, int], None] | None = None
) -> str:
    """Search the pose of the first image that shows anything with each of the usual mistakes undone.

    Parameters
    ----------
    dataset : Dataset
        With images.
    descent : Descent
        Its prior, and the IMU from there on, tell where to search.
    report : callable, optional
        Called with the number of mistakes that were tried, and how many there are.

    Returns
    -------
    str
        What was undone when most craters were found, and how many; empty when no correction helps.
    """
    index = _first_with_contrast(dataset)
    stamps_ns = dataset.stamps_ns
    predicted = filter_state.prior(descent)
    if index:
        predicted = filter_state.propagate(predicted, descent, int(stamps_ns[0]), int(stamps_ns[index]))
    covariance = predicted.covariance[POSE, POSE]
    best, text = _MIN_CRATERS - 1, ""
    corrections = list(_corrections(dataset, index))
    for tried, one in enumerate(corrections):
        if report is not None:
            report(tried, len(corrections))
        found = acquire(one.image, one.camera, one.catalog, predicted.gTb, covariance, one.sun_g)
        if found is not None and len(found.craters) > best:
            best = len(found.craters)
            where = "the first image" if not index else dataset.image_paths[index].name
            text = f"{best} craters are found in {where} if {one.what}"
    if report is not None:
        report(len(corrections), len(corrections))
    return text


def _first_with_contrast(dataset: Dataset) -> int:
    """Index of the first image, of some, that is not of one brightness: a lens cap, a dark frame."""
    least = _LEAST_CONTRAST * dataset.camera.full_scale
    for index in range(min(len(dataset), _MAX_IMAGES)):
        low, high = np.percentile(dataset.image(index)[::4, ::4], [5.0, 95.0])
        if high - low > least:
            return index
    return 0


def _corrections(dataset: Dataset, index: int) -> Iterator[_Corrected]:
    image: npt.NDArray[Any] = dataset.image(index)
    camera, catalog = dataset.camera, dataset.catalog
    sun_g = dataset.sun.at(int(dataset.stamps_ns[index]))
    given = _Corrected("", image, camera, catalog, sun_g)
    mirrored = replace(camera, cx_px=camera.width_px - 1 - camera.cx_px)
    turned = replace(mirrored, cy_px=camera.height_px - 1 - camera.cy_px)
    images = [
        ("mirrored left to right", image[:, ::-1], mirrored),
        ("turned by 180 deg", image[::-1, ::-1], turned),
        (
            "taken for a negative, or if the sun of sun.csv stands on the opposite side",
            image.dtype.type(camera.full_scale) - image,
            camera,
        ),
    ]
    if camera.width_px == camera.height_px:
        across = replace(
            camera, cx_px=camera.cy_px, cy_px=camera.cx_px, fx_px=camera.fy_px, fy_px=camera.fx_px
        )
        images += [
            ("transposed: rows for columns", image.T, across),
            ("turned by 90 deg clockwise", np.rot90(image, -1), across),
            ("turned by 90 deg anticlockwise", np.rot90(image), across),
        ]
    for what, values, through in images:
        yield replace(given, what=f"it is {what}", image=np.ascontiguousarray(values), camera=through)
    yield replace(given, what="the vector in sun.csv is reversed", sun_g=-sun_g)
    for factor, what in ((2.0, "doubled (radii for diameters?)"), (0.5, "halved (diameters for radii?)")):
        yield replace(
            given, what=f"the diameters in the catalogue are {what}", catalog=_resized(catalog, factor)
        )
    west = replace(catalog, longitude_rad=np.mod(-catalog.longitude_rad, 2.0 * np.pi))
    yield replace(given, what="the longitudes in the catalogue are positive west", catalog=west)
    south = replace(catalog, latitude_rad=-catalog.latitude_rad)
    yield replace(given, what="the latitudes in the catalogue are positive south", catalog=south)


def turned_about_axis(camera: Camera, gTb: FloatArray, other_gTb: FloatArray) -> bool:
    """Whether two poses of the body differ by about half a turn about the camera's axis.

    Parameters
    ----------
    camera : Camera
    gTb, other_gTb : ndarray, shape (4, 4)
        In g, m.

    Returns
    -------
    bool
    """
    turn = frames.rotation_log((camera.gTc(gTb)[:3, :3]).T @ camera.gTc(other_gTb)[:3, :3])
    return bool(abs(turn[2]) > np.radians(180.0 - _MAX_OFF_HALF_TURN_DEG))


def _resized(catalog: Catalog, factor: float) -> Catalog:
    return replace(
        catalog, semi_major_m=factor * catalog.semi_major_m, semi_minor_m=factor * catalog.semi_minor_m
    )
