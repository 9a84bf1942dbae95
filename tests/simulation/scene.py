"""A descent over the Moon, its craters and its camera, for the tests of terrain and images."""

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.relief import Relief, ReliefOptions
from factors.arrays import FloatArray

MOON = Body("Moon", 1737400.0, 4.9028e12, (0.0, 0.0, 2.6617e-6))
FOCAL = 512.0 / np.tan(np.radians(22.0))
CAMERA = Camera(1024, 1024, FOCAL, FOCAL, 511.5, 511.5)
SITE = frames.east_north_up(np.array(0.35), np.array(0.5))


def place(east_m: float, north_m: float, altitude_m: float) -> FloatArray:
    """Point in g, east and north of the site."""
    ray = SITE @ np.array([east_m, north_m, MOON.radius_m])
    return (MOON.radius_m + altitude_m) * ray / np.linalg.norm(ray)


def pose(P: FloatArray, tilt_deg: float = 0.0, heading_deg: float = 90.0) -> FloatArray:
    """Lander at P whose camera looks down, tilted towards a heading from north to east; image top ahead."""
    enu = frames.east_north_up(*frames.latitude_longitude(P))
    heading, tilt = np.radians([heading_deg, tilt_deg])
    ahead = enu @ np.array([np.sin(heading), np.cos(heading), 0.0])
    up = enu[:, 2]
    z = -np.cos(tilt) * up + np.sin(tilt) * ahead
    y = -np.cos(tilt) * ahead - np.sin(tilt) * up
    return frames.pose(np.stack([np.cross(y, z), y, z], axis=-1), P)


def sun(elevation_deg: float, azimuth_deg: float) -> FloatArray:
    """Direction towards the sun in g, seen from the site; azimuth from north to east."""
    el, az = np.radians([elevation_deg, azimuth_deg])
    return SITE @ np.array([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)])


def track(count: int = 60) -> FloatArray:
    """Positions of a descent from 50 km to 4 km over 150 km towards the east."""
    s = np.linspace(0.0, 1.0, count)
    return np.stack([place(-150e3 * (1.0 - u), 0.0, 50e3 - 46e3 * u) for u in s])


def relief(slope: float = 0.012) -> Relief:
    return Relief(MOON, SITE[:, 2], ReliefOptions(slope=slope))


def craters(rows: list[tuple[float, float, float, float, float, float]]) -> Catalog:
    """Catalogue of (east, north, semi-major, semi-minor, height) in m and the angle in rad."""
    east, north, a, b, height, angle = np.array(rows, dtype=np.float64).reshape(-1, 6).T
    P = np.array([place(e, n, 0.0) for e, n in zip(east, north, strict=True)]).reshape(-1, 3)
    lat, lon = frames.latitude_longitude(P)
    names = tuple(f"C{i}" for i in range(len(east)))
    return Catalog(names, lat, lon, a, b, angle, height, MOON)


def rim(catalog: Catalog, row: int, theta: FloatArray, rho: float = 1.0) -> FloatArray:
    """Points (n, 3) in g of the rim's plane, `rho` rim radii from its centre."""
    c, s = rho * np.cos(theta)[:, None], rho * np.sin(theta)[:, None]
    return catalog.centres[row] + c * catalog.axes[row, 0] + s * catalog.axes[row, 1]


def project(gTb: FloatArray, points: FloatArray, camera: Camera = CAMERA) -> FloatArray:
    return camera.project((points - gTb[:3, 3]) @ gTb[:3, :3])
