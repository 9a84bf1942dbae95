"""A descent over the Moon, its craters and its camera, for the tests of terrain and images."""

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalog import Catalog
from craternav_fg.simulation.relief import Relief, ReliefOptions

FloatArray = npt.NDArray[np.float64]

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


def crest_offsets_px(renderer, catalog, gTb, rows, count=16, reach_px=1.6):
    """How far outside the projected rim the ground rises no more, along the rim's normals, (rows, count).

    In the pixels of the renderer's camera, which has no mounting and no distortion. Found in the ground's
    own normals at the points where rays through the pixels meet it.
    """
    camera = renderer.camera
    theta = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    offsets = np.linspace(-reach_px, reach_px, 17)
    out = np.full((len(rows), count), np.nan)
    for k, row in enumerate(rows):
        rim_px = project(gTb, rim(catalog, row, theta), camera)
        along = project(gTb, rim(catalog, row, theta + 1e-4), camera) - rim_px
        normal = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.linalg.norm(along, axis=1)[:, None]
        middle = project(gTb, catalog.centres[row : row + 1], camera)
        normal *= np.sign(np.sum(normal * (rim_px - middle), axis=1, keepdims=True))
        px = rim_px[:, None] + offsets[:, None] * normal[:, None]
        _, ground = renderer.ground_points(gTb, px.reshape(-1, 2))
        local = (ground @ catalog.gRl[row]).reshape(count, len(offsets), 3)
        outward = np.stack(
            [np.cos(theta) / catalog.semi_major_m[row], np.sin(theta) / catalog.semi_minor_m[row]], axis=-1
        )
        rise = -np.einsum("aoi,ai->ao", local[:, :, :2], outward) / local[:, :, 2]
        for a in range(count):
            cross = np.flatnonzero((rise[a, :-1] > 0.0) & (rise[a, 1:] <= 0.0))
            if len(cross):
                i = cross[np.argmin(np.abs(offsets[cross]))]
                out[k, a] = np.interp(0.0, -rise[a, i : i + 2], offsets[i : i + 2])
    return out
