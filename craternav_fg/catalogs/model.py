"""The catalogue of craters: rims as ellipses on the body, and which of them a camera sees."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.common_shift import (
    CommonShift,
    shift_covariance,
    tilt_covariance,
    unknown_height_sigma_m,
)
from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.catalogs.rim_kernel import rim_geometry, visible_rims
from craternav_fg.catalogs.sphere_index import SphereIndex
from craternav_fg.ellipse import half_sides, pixel_chart, points_on
from factors.arrays import FloatArray, IntArray

# Along each side of the image, to find the point farthest from the optical axis.
_BORDER_POINTS = 33
# Between the points a border that a lens bends may lie farther out: factor on the squared distance.
_BENT_BORDER_SLACK = 1.02
# Cosine of the half-angle of a field of view that has no bound in front of the camera.
_ANY_DIRECTION = 1e-3


@dataclass(frozen=True)
class Catalog:
    """Craters of a catalogue. A rim is a planar ellipse whose centre is `height_m` above the sphere.

    Attributes
    ----------
    identifiers : tuple of str, length n
        Unique names.
    latitude_rad, longitude_rad : ndarray, shape (n,)
        Position of the rim's centre; longitude to the east.
    semi_major_m, semi_minor_m : ndarray, shape (n,)
        Semi-axes a >= b > 0 of the rim.
    angle_rad : ndarray, shape (n,)
        Direction of the major axis, from local east towards north, in the plane of a level rim; a tilted one
        is turned from there by the smallest rotation.
    height_m : ndarray, shape (n,)
        Height of the rim's plane above the sphere, at the rim's centre.
    body : Body
        Body with these craters.
    errors : MapErrors or None
        Standard deviations of the rims; None if the catalogue states none.
    has_heights : bool
        False when the heights are unknown: `height_m` then puts all rims on the sphere.
    common_shift : CommonShift or None
        How far all rims of a source may be off together; None when the catalogue does not say.
    plane_tilt_rad : ndarray, shape (n, 2), or None
        Slopes of the rims' planes towards east and north, positive where the plane rises; None when all are
        level, normal to the radius.
    sphere_stated : bool
        False when nobody has said to which sphere the heights refer, and that of `body` was assumed.
    """

    identifiers: tuple[str, ...]
    latitude_rad: FloatArray
    longitude_rad: FloatArray
    semi_major_m: FloatArray
    semi_minor_m: FloatArray
    angle_rad: FloatArray
    height_m: FloatArray
    body: Body
    errors: MapErrors | None = None
    has_heights: bool = True
    common_shift: CommonShift | None = None
    plane_tilt_rad: FloatArray | None = None
    sphere_stated: bool = True

    def __len__(self) -> int:
        return len(self.identifiers)

    def take(self, rows: IntArray) -> "Catalog":
        """Select craters.

        Parameters
        ----------
        rows : ndarray of int, shape (k,)
        """
        return Catalog(
            tuple(self.identifiers[row] for row in rows),
            self.latitude_rad[rows],
            self.longitude_rad[rows],
            self.semi_major_m[rows],
            self.semi_minor_m[rows],
            self.angle_rad[rows],
            self.height_m[rows],
            self.body,
            None if self.errors is None else self.errors.take(rows),
            self.has_heights,
            None if self.common_shift is None else self.common_shift.take(rows),
            None if self.plane_tilt_rad is None else self.plane_tilt_rad[rows],
            self.sphere_stated,
        )

    @classmethod
    def joined(cls, parts: Sequence["Catalog"]) -> "Catalog":
        """Join catalogues of one body.

        Parameters
        ----------
        parts : sequence of Catalog
            One or more; their identifiers must differ. Where only some state errors, the others are exact.
            Where only some state heights, all rims are put on the sphere. Where only some state a common
            shift, that of the others stays unknown; equal numbers of sources are the same source. Where only
            some state tilts, the planes of the others are level.
        """
        numbers = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in (
                "latitude_rad", "longitude_rad", "semi_major_m", "semi_minor_m", "angle_rad", "height_m",
            )
        }  # fmt: skip
        has_heights = all(part.has_heights for part in parts if len(part))
        if not has_heights:
            numbers["height_m"] = np.zeros_like(numbers["height_m"])
        identifiers = tuple(name for part in parts for name in part.identifiers)
        errors = None
        if any(part.errors is not None for part in parts):
            errors = MapErrors.joined([part.errors or MapErrors.zeros(len(part)) for part in parts])
        shift = None
        if any(part.common_shift is not None for part in parts):
            shift = CommonShift.joined(
                [part.common_shift or CommonShift.unknown(len(part)) for part in parts]
            )
        tilt = None
        if any(part.plane_tilt_rad is not None for part in parts):
            tilt = np.concatenate([part.tilts_rad() for part in parts])
        return cls(
            identifiers, body=parts[0].body, errors=errors, common_shift=shift,
            has_heights=has_heights, plane_tilt_rad=tilt,
            sphere_stated=all(part.sphere_stated for part in parts), **numbers,
        )  # fmt: skip

    def tilts_rad(self) -> FloatArray:
        """Return the slopes of the rims' planes towards east and north, also where all are level.

        Returns
        -------
        ndarray, shape (n, 2)
            rad.
        """
        return np.zeros((len(self), 2)) if self.plane_tilt_rad is None else self.plane_tilt_rad

    @cached_property
    def gRl(self) -> FloatArray:
        """Rotations (n, 3, 3) from each crater's local frame l (x along a, y along b, z outward) to g.

        z is normal to the rim's plane.
        """
        if self.plane_tilt_rad is not None:
            sizes = np.stack([self.semi_major_m, self.semi_minor_m], axis=-1)
            units = self.axes / sizes[:, :, None]
            return np.stack([units[:, 0], units[:, 1], self.normals], axis=-1)
        enu = frames.east_north_up(self.latitude_rad, self.longitude_rad)
        cos, sin = np.cos(self.angle_rad)[:, None], np.sin(self.angle_rad)[:, None]
        l1 = cos * enu[:, :, 0] + sin * enu[:, :, 1]
        l2 = -sin * enu[:, :, 0] + cos * enu[:, :, 1]
        return np.stack([l1, l2, enu[:, :, 2]], axis=-1)

    @cached_property
    def up(self) -> FloatArray:
        """Unit vectors (n, 3) from the body's centre to the rims' centres, in g."""
        if self.plane_tilt_rad is None:
            return self.normals
        return frames.up(self.latitude_rad, self.longitude_rad)

    @property
    def centres(self) -> FloatArray:
        """Rim centres gL (n, 3) in g, m."""
        return self._geometry[0]

    @property
    def axes(self) -> FloatArray:
        """Semi-axes a l1 and b l2 in g, shape (n, 2, 3), m."""
        return self._geometry[1]

    @property
    def normals(self) -> FloatArray:
        """Outward unit normals (n, 3) of the rim planes in g."""
        return self._geometry[2]

    @cached_property
    def _geometry(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return rim_geometry(
            self.latitude_rad, self.longitude_rad, self.semi_major_m, self.semi_minor_m, self.angle_rad,
            self._kernel_tilt, self.height_m, self.body.radius_m,
        )  # fmt: skip

    @property
    def _kernel_tilt(self) -> FloatArray:
        """As `rim_kernel` takes it: without rows where all planes are level."""
        tilt = self.plane_tilt_rad
        return np.empty((0, 2)) if tilt is None else np.ascontiguousarray(tilt, dtype=np.float64)

    @cached_property
    def index(self) -> SphereIndex:
        """Spatial index of the rims' centres."""
        range_m = self.body.radius_m + self.height_m
        return SphereIndex.of(
            self.latitude_rad, self.longitude_rad, self.semi_major_m, self.semi_minor_m, range_m
        )

    def near(
        self,
        latitude_rad: float,
        longitude_rad: float,
        distance_m: float,
        *,
        min_diameter_m: float = 0.0,
    ) -> tuple[IntArray, FloatArray]:
        """Find the craters around a place, the nearest first.

        Parameters
        ----------
        latitude_rad, longitude_rad : float
        distance_m : float
            Largest distance of a rim's centre along the sphere.
        min_diameter_m : float
            Smallest major diameter.

        Returns
        -------
        craters : ndarray of int, shape (k,)
            Rows of the catalogue.
        distance_m : ndarray, shape (k,)
            Distance of the rims' centres along the sphere.
        """
        place = frames.up(np.array(latitude_rad), np.array(longitude_rad))
        rows = self.index.near(place, distance_m / self.body.radius_m, 0.5 * min_diameter_m)
        away_m = self._along_sphere_m(frames.up(self.latitude_rad[rows], self.longitude_rad[rows]), place)
        nearest = np.argsort(away_m, kind="stable")
        return rows[nearest], away_m[nearest]

    def distance_m(self, rows: IntArray, others: IntArray) -> FloatArray:
        """Compute distances between rims' centres along the sphere.

        Parameters
        ----------
        rows, others : ndarray of int, shape (k,)
            Pairs of craters.

        Returns
        -------
        ndarray, shape (k,)
            Distances, m.
        """
        one, other = (frames.up(self.latitude_rad[k], self.longitude_rad[k]) for k in (rows, others))
        return self._along_sphere_m(one, other)

    def _along_sphere_m(self, one: FloatArray, other: FloatArray) -> FloatArray:
        chord = np.linalg.norm(one - other, axis=-1)
        return np.asarray(2.0 * self.body.radius_m * np.arcsin(np.minimum(0.5 * chord, 1.0)))

    def shift_covariance(self, gTb: FloatArray, weights: FloatArray) -> FloatArray:
        """Compute what the craters' common shift adds to the covariances of poses that rest on them.

        Where the heights are unknown, this includes the height that all rims have in common: ground that is
        higher as a whole shifts the pose up with it, and no rim shows that.

        Parameters
        ----------
        gTb : ndarray, shape (k, 4, 4)
            Poses of the body in g, m.
        weights : ndarray, shape (n,)
            What each crater contributes to the poses, in any unit; 0 for one that was not used.

        Returns
        -------
        ndarray, shape (k, 6, 6)
            Covariance of the attitude error (rotation vector in b, rad) and the position error (in g, m);
            zero where the catalogue states heights and no common shift.
        """
        place_m, height_m = 0.0, 0.0
        if self.common_shift is not None:
            place_m, height_m = self.common_shift.of_mean(weights)
        height_m = float(np.hypot(height_m, self.unknown_height_sigma_m))
        return shift_covariance(gTb, place_m, height_m, self.body.radius_m)

    def image_covariance(
        self, gTb: FloatArray, weights: FloatArray, attitude_share: float = 1.0
    ) -> FloatArray:
        """Compute what the map's errors add to the covariance of the pose of a single image.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Pose of the body in g, m.
        weights : ndarray, shape (n,)
            See `shift_covariance`.
        attitude_share : float
            Share of the attitude's information that is from the rims, not from another sensor.

        Returns
        -------
        ndarray, shape (6, 6)
            As `shift_covariance`; where the heights are unknown, with the slope of the ground too.
        """
        shift = self.shift_covariance(gTb[None], weights)[0]
        if self.has_heights or not np.any(weights):
            return shift
        tilt = tilt_covariance(gTb, self.centres[weights != 0.0], self.body.radius_m)
        return np.asarray(shift + attitude_share**2 * tilt)

    @property
    def unknown_height_sigma_m(self) -> float:
        """Standard deviation of the height that all rims have in common, m; 0 when the heights are known."""
        return 0.0 if self.has_heights else unknown_height_sigma_m(self.body.radius_m)

    def visible(
        self,
        camera: Camera,
        gTb: FloatArray,
        *,
        min_semi_minor_px: float,
        margin_px: float = 0.0,
        sun_g: FloatArray | None = None,
        min_sun_elevation_rad: float = 0.0,
    ) -> tuple[IntArray, FloatArray]:
        """Find the craters whose whole rim a camera sees: in view, above the horizon, large enough, lit.

        Parameters
        ----------
        camera : Camera
            With its mounting.
        gTb : ndarray, shape (4, 4)
            Pose of the body in g.
        min_semi_minor_px : float
            Least semi-minor axis of the rim's image, without distortion.
        margin_px : float
            Least distance of the rim's bounding box inside the image's border; negative: outside.
        sun_g : ndarray, shape (3,), optional
            Unit vector towards the sun in g; without it craters need not be lit.
        min_sun_elevation_rad : float
            Least elevation of the sun at the rim's centre.

        Returns
        -------
        craters : ndarray of int, shape (k,)
            Rows of the catalogue, increasing.
        charts : ndarray, shape (k, 5)
            Charts of their images, in normalised image coordinates.
        """
        gTc = camera.gTc(gTb)
        cos_field = _cos_field(camera, margin_px)
        # The image of a ball around the rim bounds the rim's: it tells how far a crater may be.
        p = min_semi_minor_px / max(camera.fx_px, camera.fy_px)
        reach = np.sqrt(1.0 + p * p) / (p * cos_field) if p > 0.0 else np.inf
        rows = self.index.in_view(gTc[:3, 3], gTc[:3, 2], cos_field, reach)
        if sun_g is not None:
            up = frames.up(self.latitude_rad[rows], self.longitude_rad[rows])
            rows = rows[up @ sun_g >= np.sin(min_sun_elevation_rad)]
        charts, seen = visible_rims(
            np.ascontiguousarray(gTb, dtype=np.float64), camera.bTc, rows, self.latitude_rad,
            self.longitude_rad, self.semi_major_m, self.semi_minor_m, self.angle_rad, self._kernel_tilt,
            self.height_m, self.body.radius_m, camera.lens, float(min_semi_minor_px),
        )  # fmt: skip
        rows, charts = rows[seen], charts[seen]
        if camera.distorts:
            inside = np.all(camera.contains(camera.pixels(points_on(charts)), margin_px), axis=-1)
        else:
            charts_px = pixel_chart(charts, camera)
            centre_px, half_px = charts_px[:, :2], half_sides(charts_px)
            inside = camera.contains(centre_px - half_px, margin_px) & camera.contains(
                centre_px + half_px, margin_px
            )
        rows, charts = rows[inside], charts[inside]
        order = np.argsort(rows)
        return rows[order], charts[order]


def _cos_field(camera: Camera, margin_px: float) -> float:
    """Cosine of the largest angle from the optical axis inside an image with a margin."""
    r2 = np.sum(camera.normalised(camera.border_px(_BORDER_POINTS, margin_px)) ** 2, axis=-1)
    if not np.all(np.isfinite(r2)):
        # Beyond a lens's fold the border may lie anywhere.
        return _ANY_DIRECTION
    slack = _BENT_BORDER_SLACK if camera.distorts else 1.0
    return float(1.0 / np.sqrt(1.0 + slack * np.max(r2)))
