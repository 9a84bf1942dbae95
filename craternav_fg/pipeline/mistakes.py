"""Usual mistakes in a data set whose images contradict its initial state: which one explains them."""

from collections.abc import Iterator
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


def likely_mistake(dataset: Dataset, descent: Descent) -> str:
    """Search the pose of the first image with each of the usual mistakes undone.

    Parameters
    ----------
    dataset : Dataset
        With images.
    descent : Descent
        Its prior tells where to search.

    Returns
    -------
    str
        What was undone when most craters were found, and how many; empty when no correction helps.
    """
    prior = filter_state.prior(descent)
    covariance = prior.covariance[POSE, POSE]
    best, text = _MIN_CRATERS - 1, ""
    for one in _corrections(dataset):
        found = acquire(one.image, one.camera, one.catalog, prior.gTb, covariance, one.sun_g)
        if found is not None and len(found.craters) > best:
            best = len(found.craters)
            text = f"{best} craters are found in the first image if {one.what}"
    return text


def _corrections(dataset: Dataset) -> Iterator[_Corrected]:
    image: npt.NDArray[Any] = dataset.image(0)
    camera, catalog = dataset.camera, dataset.catalog
    sun_g = dataset.sun.at(int(dataset.stamps_ns[0]))
    given = _Corrected("", image, camera, catalog, sun_g)
    mirrored = replace(camera, cx_px=camera.width_px - 1 - camera.cx_px)
    turned = replace(mirrored, cy_px=camera.height_px - 1 - camera.cy_px)
    for what, values, through in (
        ("mirrored left to right", image[:, ::-1], mirrored),
        ("turned by 180 deg", image[::-1, ::-1], turned),
        (
            "taken for a negative, or if the sun of sun.csv stands on the opposite side",
            image.dtype.type(camera.full_scale) - image,
            camera,
        ),
    ):
        yield replace(given, what=f"it is {what}", image=np.ascontiguousarray(values), camera=through)
    yield replace(given, what="the vector in sun.csv is reversed", sun_g=-sun_g)
    for factor, what in ((2.0, "doubled (radii for diameters?)"), (0.5, "halved (diameters for radii?)")):
        yield replace(
            given, what=f"the diameters in the catalogue are {what}", catalog=_resized(catalog, factor)
        )
    west = replace(catalog, longitude_rad=np.mod(-catalog.longitude_rad, 2.0 * np.pi))
    yield replace(given, what="the longitudes in the catalogue are positive west", catalog=west)


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
