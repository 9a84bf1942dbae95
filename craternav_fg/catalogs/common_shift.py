"""The shift that all craters of a source have in common, and what it adds to the covariance of a pose.

A catalogue was traced on one map, whose own control network is off by tens of metres. The whole map then
lies turned about the body's centre by a small angle, and too high or too low. Images do not show it: the
trajectory turns and rises with the map, and gravity hardly changes. Estimators therefore give poses relative
to the map; relative to the body, the covariance of the common shift comes on top. This is exact where only
the map tells where the lander is, and too much where a narrow initial state or another sensor tells it too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from craternav_fg import frames
from factors.arrays import FloatArray, IntArray

# Standard deviation of the ground's height above the sphere where a catalogue states no heights. Chosen: on
# the Moon and on Mars ground differs from the sphere by kilometres, about a thousandth of the radius. Smaller
# bodies are less round, as their gravity is weaker. The axes of the IAU's ellipsoids (Archinal et al. 2018)
# differ from spheres by 0.2 % (rms, Dione), 0.9 % (Enceladus), 2.3 % (Mimas), 2.2 % (Ceres), 7 % (Vesta) and
# 9 % (Phobos); those of Bennu by 3 %. The power gives 0.5, 1.8, 2.6, 0.7, 1.8, 10 and 10 %.
_HEIGHT_RADII, _HEIGHT_BODY_M, _HEIGHT_POWER, _MAX_HEIGHT_RADII = 1e-3, 1737400.0, 1.5, 0.1
# Standard deviation of the ground's slope, per axis, over that of the height, times the radius of the ground
# in view; and the largest. Planes fitted to discs of 20, 40, 80 and 160 km of the Moon's elevation model
# GLD100 slope by 4e-4 to 4.5e-4 of its radius over theirs.
_UNKNOWN_TILT_HEIGHTS, _MAX_TILT = 0.4, 0.1


@dataclass(frozen=True)
class CommonShift:
    """Standard deviations of the shift that the craters of a source have in common, one value per crater.

    Attributes
    ----------
    place_m : ndarray, shape (n,)
        Sigma per axis along the ground, m; NaN where the source does not state it.
    height_m : ndarray, shape (n,)
        Sigma of the heights of the rims, m; NaN where the source does not state it.
    source : ndarray of int, shape (n,)
        Number of the crater's source. Craters of one source shift together, different sources independently.
    """

    place_m: FloatArray
    height_m: FloatArray
    source: IntArray

    @classmethod
    def zeros(cls, count: int) -> "CommonShift":
        """Make the shift of a catalogue that has none.

        Parameters
        ----------
        count : int
            Number of craters.
        """
        return cls(np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.int64))

    @classmethod
    def unknown(cls, count: int) -> "CommonShift":
        """Make the shift of a catalogue that does not state its shift.

        Parameters
        ----------
        count : int
            Number of craters.
        """
        return cls(np.full(count, np.nan), np.full(count, np.nan), np.zeros(count, dtype=np.int64))

    @classmethod
    def of_source(cls, count: int, place_m: float, height_m: float) -> "CommonShift | None":
        """Make the shift of craters of one source.

        Parameters
        ----------
        count : int
            Number of craters.
        place_m, height_m : float

        Returns
        -------
        CommonShift or None
            None where both are zero.
        """
        if place_m == 0.0 and height_m == 0.0:
            return None
        return cls(np.full(count, place_m), np.full(count, height_m), np.zeros(count, dtype=np.int64))

    def take(self, rows: IntArray) -> "CommonShift":
        """Select craters.

        Parameters
        ----------
        rows : ndarray of int, shape (k,)
        """
        return CommonShift(self.place_m[rows], self.height_m[rows], self.source[rows])

    def replaced(self, rows: IntArray, others: "CommonShift") -> "CommonShift":
        """Replace the sigmas and the source of some craters.

        Parameters
        ----------
        rows : ndarray of int, shape (k,)
        others : CommonShift
            Sigmas of k craters.
        """
        out = CommonShift(self.place_m.copy(), self.height_m.copy(), self.source.copy())
        out.place_m[rows], out.height_m[rows], out.source[rows] = (
            others.place_m,
            others.height_m,
            others.source,
        )
        return out

    @classmethod
    def joined(cls, parts: Sequence["CommonShift"]) -> "CommonShift":
        """Join the sigmas of several catalogues.

        Parameters
        ----------
        parts : sequence of CommonShift
            One or more. Equal numbers of sources are the same source.
        """
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def of_mean(self, weights: FloatArray) -> tuple[float, float]:
        """Combine the shifts of the sources that a pose rests on.

        Parameters
        ----------
        weights : ndarray, shape (n,)
            What each crater contributes to the pose, in any unit; 0 for one that was not used.

        Returns
        -------
        place_m, height_m : float
            Sigmas of the weighted mean of the sources' shifts, m: of the craters whose sigma is stated, 0 if
            none is.
        """
        return self._of_mean(self.place_m, weights), self._of_mean(self.height_m, weights)

    def _of_mean(self, sigmas: FloatArray, weights: FloatArray) -> float:
        used = np.flatnonzero((weights != 0.0) & ~np.isnan(sigmas))
        if not len(used):
            return 0.0
        _, of_crater = np.unique(self.source[used], return_inverse=True)
        of_source = np.bincount(of_crater, weights[used] * sigmas[used]) / weights[used].sum()
        return float(np.linalg.norm(of_source))


def shift_covariance(gTb: FloatArray, place_m: float, height_m: float, radius_m: float) -> FloatArray:
    """Compute the covariance of poses that a common shift of the map causes.

    Parameters
    ----------
    gTb : ndarray, shape (k, 4, 4)
        Poses of the body in g, m.
    place_m, height_m : float
        Standard deviations of the shift, per axis along the ground and of the height, m.
    radius_m : float
        Radius of the sphere on which the map shifts.

    Returns
    -------
    ndarray, shape (k, 6, 6)
        Covariance of the attitude error (rotation vector in b, rad) and the position error (in g, m).
    """
    gP = gTb[:, :3, 3]
    range_m = np.linalg.norm(gP, axis=1)
    enu = frames.east_north_up(*frames.latitude_longitude(gP))
    J = np.zeros((len(gTb), 6, 3))
    # A shift d along the ground is a turn of up x d / radius.
    turn = np.stack([enu[:, :, 1], -enu[:, :, 0]], axis=-1) / radius_m
    J[:, :3, :2] = np.swapaxes(gTb[:, :3, :3], 1, 2) @ turn
    J[:, 3:, :2] = enu[:, :, :2] * (range_m / radius_m)[:, None, None]
    J[:, 3:, 2] = enu[:, :, 2]
    return np.asarray((J * np.array([place_m, place_m, height_m]) ** 2) @ np.swapaxes(J, 1, 2))


def unknown_height_sigma_m(radius_m: float) -> float:
    """Return the standard deviation of the ground's height above the sphere, if nothing is known of it.

    Parameters
    ----------
    radius_m : float
        Of the body.

    Returns
    -------
    float
        In m: 0.1 % of the radius of the Moon and of larger bodies, up to 10 % below 80 km.
    """
    share = _HEIGHT_RADII * max(1.0, _HEIGHT_BODY_M / radius_m) ** _HEIGHT_POWER
    return min(share, _MAX_HEIGHT_RADII) * radius_m


def tilt_covariance(gTb: FloatArray, centres: FloatArray, radius_m: float) -> FloatArray:
    """Compute the covariance of an image's pose that the slope of ground of unknown heights causes.

    Ground that slopes as a whole looks like level ground to a camera that is turned about it.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the body in g, m.
    centres : ndarray, shape (n, 3)
        Centres of the rims on which it rests, in g, m.
    radius_m : float
        Radius of the body.

    Returns
    -------
    ndarray, shape (6, 6)
        Covariance of the attitude error (rotation vector in b, rad) and the position error (in g, m).
    """
    middle = centres.mean(axis=0)
    # The radius of a disc is sqrt(2) times the RMS distance from its middle.
    disc_m = np.sqrt(2.0 * np.mean(np.sum((centres - middle) ** 2, axis=1)))
    sigma_rad, rise_m = _MAX_TILT, _UNKNOWN_TILT_HEIGHTS * unknown_height_sigma_m(radius_m)
    if _MAX_TILT * disc_m > rise_m:
        sigma_rad = rise_m / disc_m
    level = frames.east_north_up(*frames.latitude_longitude(middle[None]))[0, :, :2]
    J = np.empty((6, 2))
    J[:3] = gTb[:3, :3].T @ level
    J[3:] = np.cross(level.T, gTb[:3, 3] - middle).T
    return np.asarray(sigma_rad**2 * (J @ J.T))


def share_of_rims(covariance: FloatArray, known: FloatArray) -> float:
    """Compute the share of the information on an attitude that is from rims, not from another sensor.

    Parameters
    ----------
    covariance : ndarray, shape (3, 3)
        Of the attitude from both (rotation vector in b), rad^2.
    known : ndarray, shape (3, 3)
        Of the other sensor's attitude (rotation vector in b), rad^2; zero for an exact one.

    Returns
    -------
    float
        0 to 1.
    """
    if not np.any(known):
        return 0.0
    return float(np.clip(1.0 - np.trace(np.linalg.solve(known, covariance)) / 3.0, 0.0, 1.0))


def unknown_height_warnings(sigma_m: float) -> tuple[str, ...]:
    """Warn of a catalogue that does not say how high its rims lie.

    Parameters
    ----------
    sigma_m : float
        See `Catalog.unknown_height_sigma_m`.

    Returns
    -------
    tuple of str
        One sentence; none when the heights are known.
    """
    if sigma_m == 0.0:
        return ()
    return (
        "the catalogue has no RIM_HEIGHT_M, or zeros in all rows: its rims are taken to lie on the sphere. A "
        f"height that all have in common cannot be observed; {sigma_m:.4g} m of it are in the covariance of "
        "positions. Take the heights from an elevation model (craternav catalog import --dem)",
    )
