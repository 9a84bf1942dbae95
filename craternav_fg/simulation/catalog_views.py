"""Simulated views of a crater catalogue with known matches: what identification is tested and timed on."""

from dataclasses import dataclass

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.ellipse import axes_of_chart, pixel_chart
from factors.arrays import FloatArray, IntArray

SIDE_PX = 1024
# Craters larger than a diameter in km, in the 21,433 of a thinned global catalogue of Robbins (2018).
_DIAMETERS_KM = np.array([3.9, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0])
_LARGER = np.array([21433.0, 14477.0, 10855.0, 7164.0, 5150.0, 2604.0, 1504.0, 695.0, 249.0, 11.0, 0.5])
# Of ln(a / b) in that catalogue: its median, and the standard deviation of its logarithm; the largest drawn.
_FLATTENING, _FLATTENING_SPREAD, _MAX_FLATTENING = 0.0725, 0.79, 0.6
# Sizes of false rims are those of true ones with this standard deviation of their logarithm.
_FALSE_SIZE_SPREAD = 0.2
# Largest ln(a / b) of false rims that are not like true ones.
_FALSE_FLATTENING = 0.35
# Answers that name this many craters right, and this share of what they name, are taken for right.
_MIN_RIGHT, _MIN_RIGHT_SHARE = 3, 2.0 / 3.0


@dataclass(frozen=True)
class ViewOptions:
    """Geometry of a view, and errors of its rims.

    Attributes
    ----------
    altitudes_m : tuple of float
        Lowest and highest; the logarithm is uniform between them.
    field_deg : float
        Field of view across the square image.
    largest_tilt_deg : float
        Largest angle of the optical axis from nadir; the tilt is uniform from 0.
    sigma_px : float
        Noise of each coordinate of a centre. That of each semi-axis is half of it, and at most a tenth of
        the axis.
    missing, false : float
        Share of the visible rims that are not found, and of the found rims that are false.
    least_px : float
        Smallest semi-minor axis that is found.
    false_radius_px : tuple of float or None
        Smallest and largest mean radius of the false rims, which then have any shape and direction, as
        shadows and ridges do; None for sizes and shapes like those of the true rims.
    """

    altitudes_m: tuple[float, float] = (100e3, 600e3)
    field_deg: float = 60.0
    largest_tilt_deg: float = 30.0
    sigma_px: float = 1.0
    missing: float = 0.25
    false: float = 0.2
    least_px: float = 5.0
    false_radius_px: tuple[float, float] | None = None


@dataclass(frozen=True)
class View:
    """Rims as found in one image, and the truth.

    Attributes
    ----------
    camera : Camera
    ellipses_px : ndarray, shape (n, 5)
        Centre, semi-axes, angle of the first from x towards y.
    gTb : ndarray, shape (4, 4)
        True pose.
    craters : ndarray of int, shape (n,)
        True row in the catalogue, -1 of a false rim.
    """

    camera: Camera
    ellipses_px: FloatArray
    gTb: FloatArray
    craters: IntArray

    @property
    def true(self) -> int:
        """Number of rims that are craters."""
        return int(np.sum(self.craters >= 0))

    def mirrored(self) -> FloatArray:
        """Ellipses of the mirror image: no pose shows these craters so.

        Returns
        -------
        ndarray, shape (n, 5)
            As `ellipses_px`.
        """
        out = self.ellipses_px.copy()
        out[:, 0] = self.camera.width_px - 1 - out[:, 0]
        out[:, 4] = -out[:, 4]
        return out

    def agrees(self, rows: IntArray) -> bool:
        """Whether an identification is right: two thirds of its named rims or more, and at least three.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
            Row in the catalogue that each rim is said to be, -1 where none is named.

        Returns
        -------
        bool
        """
        named = rows >= 0
        agree = rows[named] == self.craters[named]
        return bool(agree.sum() >= _MIN_RIGHT and agree.mean() > _MIN_RIGHT_SHARE)


def square_camera(field_deg: float, bTc: FloatArray | None = None) -> Camera:
    """Square camera of a field of view.

    Parameters
    ----------
    field_deg : float
    bTc : ndarray, shape (4, 4), optional
        Pose of the camera in b; the identity if not given.

    Returns
    -------
    Camera
    """
    focal = 0.5 * SIDE_PX / np.tan(np.radians(0.5 * field_deg))
    middle = 0.5 * (SIDE_PX - 1)
    return Camera(SIDE_PX, SIDE_PX, focal, focal, middle, middle, bTc=np.eye(4) if bTc is None else bTc)


def random_view(
    catalog: Catalog,
    options: ViewOptions,
    rng: np.random.Generator,
    *,
    true_rims: tuple[int, int] = (3, 10_000),
) -> View:
    """Draw a view from anywhere above the body.

    Parameters
    ----------
    catalog : Catalog
    options : ViewOptions
    rng : Generator
    true_rims : tuple of int
        Smallest and largest number of true rims that are found; other views are drawn again.

    Returns
    -------
    View
    """
    camera = square_camera(options.field_deg)
    while True:
        gTb = _pose(catalog.body.radius_m, options, rng)
        rows, charts = _visible(catalog, camera, gTb, options.least_px)
        kept = rng.random(len(rows)) >= options.missing
        if true_rims[0] <= kept.sum() <= true_rims[1]:
            break
    rows, charts = rows[kept], charts[kept]
    ellipses = axes_of_chart(pixel_chart(charts, camera))
    wrong = round(len(rows) * options.false / (1.0 - options.false))
    like = rng.integers(len(rows), size=wrong)
    false = ellipses[like]
    false[:, :2] = rng.uniform(0.0, SIDE_PX - 1.0, (wrong, 2))
    if options.false_radius_px is None:
        false[:, 2:4] *= np.exp(rng.normal(0.0, _FALSE_SIZE_SPREAD, (wrong, 1)))
    else:
        flattening = 0.5 * rng.uniform(0.0, _FALSE_FLATTENING, (wrong, 1)) * [1.0, -1.0]
        false[:, 2:4] = rng.uniform(*options.false_radius_px, (wrong, 1)) * np.exp(flattening)
        false[:, 4] = rng.uniform(0.0, np.pi, wrong)
    ellipses = np.concatenate([ellipses, false])
    craters = np.concatenate([rows, np.full(wrong, -1)])
    ellipses[:, :2] += rng.normal(0.0, options.sigma_px, (len(ellipses), 2))
    spread = np.minimum(0.5 * options.sigma_px, 0.1 * ellipses[:, 2:4])
    ellipses[:, 2:4] += spread * rng.normal(size=(len(ellipses), 2))
    # The nearer the axes are to each other, the further an error across them turns the ellipse.
    lean = spread.mean(axis=1) * rng.normal(size=len(ellipses)) / np.sqrt(2.0)
    a, b = ellipses[:, 2], ellipses[:, 3]
    ellipses[:, 4] += 0.5 * np.arctan2(2.0 * lean, np.abs(a - b))
    order = rng.permutation(len(ellipses))
    return View(camera, ellipses[order], gTb, craters[order])


def synthetic_catalog(body: Body, rng: np.random.Generator, *, count: int = 21_433) -> Catalog:
    """Uniformly scattered craters with the sizes and flattenings of the real ones of 4 km and more.

    Parameters
    ----------
    body : Body
    rng : Generator
    count : int

    Returns
    -------
    Catalog
    """
    share = rng.random(count)
    diameter_km = np.exp(
        np.interp(np.log(share), np.log(_LARGER / _LARGER[0])[::-1], np.log(_DIAMETERS_KM)[::-1])
    )
    flattening = _FLATTENING * np.exp(_FLATTENING_SPREAD * rng.normal(size=count))
    flattening = np.minimum(flattening, _MAX_FLATTENING)
    mean_m = 500.0 * diameter_km
    return Catalog(
        tuple(f"S{k}" for k in range(count)),
        np.arcsin(rng.uniform(-1.0, 1.0, count)),
        rng.uniform(-np.pi, np.pi, count),
        mean_m * np.exp(0.5 * flattening),
        mean_m * np.exp(-0.5 * flattening),
        rng.uniform(0.0, np.pi, count),
        np.zeros(count),
        body,
    )


def _pose(radius_m: float, options: ViewOptions, rng: np.random.Generator) -> FloatArray:
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    aside = np.cross(up, rng.normal(size=3))
    aside /= np.linalg.norm(aside)
    tilt = np.radians(rng.uniform(0.0, options.largest_tilt_deg))
    forward = -np.cos(tilt) * up + np.sin(tilt) * aside
    x = np.cross(forward, rng.normal(size=3))
    x /= np.linalg.norm(x)
    altitude = np.exp(rng.uniform(*np.log(options.altitudes_m)))
    return frames.pose(np.stack([x, np.cross(forward, x), forward], axis=-1), (radius_m + altitude) * up)


def _visible(
    catalog: Catalog, camera: Camera, gTb: FloatArray, least_px: float
) -> tuple[IntArray, FloatArray]:
    """Rows and charts of the craters in view."""
    P = gTb[:3, 3]
    above = np.linalg.norm(P)
    near = np.flatnonzero(catalog.up @ (P / above) > catalog.body.radius_m / above)
    rows, charts = catalog.take(near).visible(camera, gTb, min_semi_minor_px=least_px)
    return near[rows], charts
