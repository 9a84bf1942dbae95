"""Small analytic images of craters: a Lambertian sphere with bowls, seen from above, in a few lines."""

import cv2
import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from factors.kernels import conic

MOON = Body("Moon", 1_737_400.0, 4.9028e12, (0.0, 0.0, 2.66e-6))
SITE = frames.east_north_up(np.array(0.1), np.array(0.2))
ALTITUDE_M = 20e3
SIZE_PX = 512
# Optics, and the mean of two samples a pixel.
BLUR_PX, PIXEL_PX = 0.7, 0.25


def camera():
    focal = 0.5 * SIZE_PX / np.tan(np.deg2rad(22.0))
    middle = 0.5 * (SIZE_PX - 1)
    return Camera(
        SIZE_PX, SIZE_PX, focal, focal, middle, middle, psf_sigma_px=float(np.hypot(BLUR_PX, PIXEL_PX))
    )


def pose(heading_rad=0.3, tilt_deg=0.0):
    """Look at the site from ALTITUDE_M above it, or from the side."""
    c, s, t = np.cos(heading_rad), np.sin(heading_rad), np.deg2rad(tilt_deg)
    R = SITE @ np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]]) @ frames.rotation_exp([t, 0.0, 0.0])
    return frames.pose(R, SITE[:, 2] * MOON.radius_m - R[:, 2] * ALTITUDE_M / np.cos(t))


def moved(gTb, rotation_rad, position_m=(0.0, 0.0, 0.0)):
    out = gTb.copy()
    out[:3, :3] = gTb[:3, :3] @ frames.rotation_exp(np.asarray(rotation_rad, dtype=float))
    out[:3, 3] += position_m
    return out


def covariance(sigma_px, sigma_m=20.0):
    return np.diag([(sigma_px / camera().focal_px) ** 2] * 3 + [sigma_m**2] * 3)


def sun(elevation_deg=35.0, azimuth_deg=40.0):
    e, a = np.deg2rad([elevation_deg, azimuth_deg])
    return SITE @ np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def craters(rng, count=24, low_px=12.0, high_px=30.0, half=0.33):
    """Craters that stand apart, their rims' planes on the sphere's chord."""
    places, sizes = [], []
    while len(places) < count:
        p, b = rng.uniform(-half, half, 2) * ALTITUDE_M, rng.uniform(low_px, high_px)
        b *= ALTITUDE_M / camera().focal_px
        if all(np.hypot(*(p - q)) > 1.8 * (b + s) for q, s in zip(places, sizes, strict=True)):
            places.append(p)
            sizes.append(b)
    sizes = np.array(sizes)
    points = np.column_stack([places, np.full(count, MOON.radius_m)]) @ SITE.T
    lat, lon = frames.latitude_longitude(points)
    major = sizes / rng.uniform(0.75, 1.0, count)
    return Catalog(
        tuple(f"T{i}" for i in range(count)), lat, lon, major, sizes, rng.uniform(0.0, np.pi, count),
        -(major**2 + sizes**2) / (4.0 * MOON.radius_m), MOON, plane_tilt_rad=np.zeros((count, 2)),
    )  # fmt: skip


def slope(rho, sharpness=12.0):
    """Slope of a crater rising outward: a cone's wall and a gentle flank, rounded at rho = 1."""
    wall = 0.55 * np.clip(rho / 0.6, 0.0, 1.0)
    flank = -0.2 * np.exp(-3.0 * np.maximum(rho - 1.0, 0.0))
    # The share of the flank at which wall and flank cancel sits at rho = 1.
    share = 1.0 / (1.0 + np.exp(-sharpness * (rho - 1.0) - np.log(0.55 / 0.2)))
    return np.where(rho < 4.0, (1.0 - share) * wall + share * flank, 0.0)


def _around(points, centre, reach_m, step=16):
    """Rows and columns of an image that hold all its points (h, w, 3) within a distance of a centre."""
    near = np.linalg.norm(points[::step, ::step] - centre, axis=-1)
    # A cell more on each side, and its diagonal: the points between two that were looked at.
    near = near < reach_m + 1.5 * np.linalg.norm(points[step, step] - points[0, 0])
    slices = []
    for axis in (1, 0):
        cells = np.flatnonzero(near.any(axis=axis))
        first, last = (cells[0], cells[-1]) if len(cells) else (0, -2)
        slices.append(slice(max(0, step * (first - 1)), step * (last + 2)))
    return tuple(slices)


def render(catalog, gTb, sun_g, rng, *, noise=1.0, blur_px=BLUR_PX, roughness=0.0, level=110.0, cam=None):
    cam = cam or camera()
    v, u = np.mgrid[0 : 2 * SIZE_PX, 0 : 2 * SIZE_PX]
    rays = np.dstack([cam.normalised(np.dstack([u, v]) / 2.0 - 0.25), np.ones(u.shape)]) @ gTb[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(rays @ gTb[:3, 3])
    height2 = gTb[:3, 3] @ gTb[:3, 3] - along**2
    points = gTb[:3, 3] + (along - np.sqrt(MOON.radius_m**2 - height2))[..., None] * rays
    normal = points / MOON.radius_m
    gradient = np.zeros_like(points)
    for i in range(len(catalog)):
        axes = np.array([catalog.semi_major_m[i], catalog.semi_minor_m[i]])
        part = _around(points, catalog.centres[i], 4.0 * axes.max())
        local = (points[part] - catalog.centres[i]) @ (catalog.gRl[i][:, :2] / axes)
        rho = np.sqrt(local[..., 0] ** 2 + local[..., 1] ** 2) + 1e-9
        out = local * (slope(rho) / rho * np.sqrt(np.prod(axes)))[..., None]
        gradient[part] += out @ (catalog.gRl[i][:, :2] / axes).T
    if roughness > 0.0:
        tilt = cv2.GaussianBlur(rng.normal(size=u.shape), (0, 0), 4.0)
        dy, dx = np.gradient(tilt)
        gradient += roughness / dx.std() * (dx[..., None] * gTb[:3, 0] + dy[..., None] * gTb[:3, 1])
    facet = normal - gradient
    light = np.maximum(facet @ sun_g, 0.0) / np.linalg.norm(facet, axis=-1)
    light = cv2.GaussianBlur(light, (0, 0), 2.0 * blur_px)
    light = light.reshape(SIZE_PX, 2, SIZE_PX, 2).mean(axis=(1, 3)) * level / np.median(light)
    return np.clip(np.round(light + noise * rng.normal(size=light.shape)), 0, 255).astype(np.uint8)


def true_charts(catalog, gTb, rows):
    return conic.project_rims(gTb, np.eye(4), catalog.centres[rows], catalog.axes[rows])[0]


def semi_axes_px(charts):
    """Centre (n, 2), semi-major and semi-minor axis (n,), px, of charts (n, 5)."""
    sxx = np.exp(2.0 * charts[:, 2])
    sxy = charts[:, 3] * sxx
    S = np.stack([sxx, sxy, sxy, np.exp(2.0 * charts[:, 4]) + charts[:, 3] * sxy], axis=-1)
    axes = camera().focal_px * np.sqrt(np.linalg.eigvalsh(S.reshape(-1, 2, 2)))
    return camera().pixels(charts[:, :2]), axes[:, 1], axes[:, 0]
