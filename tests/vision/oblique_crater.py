"""One canonical crater, seen obliquely: relief that is displaced by its height, foreshortened and hidden."""

import cv2
import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.ellipse import chart_of_axes
from craternav_fg.photometry import flat_terrain_brightness, lunar_lambert_share, slope_curvature
from craternav_fg.vision import crater_profile
from craternav_fg.vision.edges import EdgeOptions, find_edge_points
from craternav_fg.vision.ground_level import own_share, smooth_share
from craternav_fg.vision.rim_shading import RimShading

PSF_PX = 0.7
SUN_ELEVATION_RAD = np.deg2rad(35.0)
# Samples along each side of a pixel, and along the ground for each of them.
FINE, ALONG = 4, 5


def cross_section():
    """Distances from the centre, slopes and heights of the canonical crater, in radii."""
    rho = np.arange(1e-3, 4.0, 1e-3)
    slope = crater_profile.slopes(rho)
    height = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(rho))])
    return rho, slope, height - np.interp(1.0, rho, height)


def crater(radius_px, emission_rad, sun_azimuth_rad, law, section=None):
    """Image of one crater that a camera above its -y side sees, its chart, px, and its shading.

    The sun's azimuth is that from the direction away from the camera. The cross-section is the canonical one
    unless another is given.
    """
    rho, slope, height = cross_section() if section is None else section
    x, y = np.cos(SUN_ELEVATION_RAD) * np.array([np.sin(sun_azimuth_rad), np.cos(sun_azimuth_rad)])
    sun = np.array([x, y, np.sin(SUN_ELEVATION_RAD)])
    view = np.array([0.0, -np.sin(emission_rad), np.cos(emission_rad)])
    share = float(lunar_lambert_share(np.arccos(view @ sun), law))
    size = int(3.6 * radius_px) + 24
    fine = ((np.arange(FINE * size) + 0.5) / FINE - 0.5 * size) / radius_px
    reach = fine[-1] / np.cos(emission_rad) + 0.5
    y = np.arange(-reach, reach, 1.0 / (FINE * ALONG * radius_px))
    columns = []
    for x in fine:
        r = np.hypot(x, y)
        s, z = np.interp(r, rho, slope, right=0.0), np.interp(r, rho, height)
        normal = np.stack([-s * x / r, -s * y / r, np.ones(len(y))]) / np.sqrt(1.0 + s * s)
        mu0, mu = np.maximum(sun @ normal, 0.0), np.maximum(view @ normal, 1e-3)
        light = 2.0 * share * mu0 / (mu0 + mu) + (1.0 - share) * mu0
        # The nearer ground hides what appears below its top.
        up = y * np.cos(emission_rad) + z * np.sin(emission_rad)
        seen = up >= np.maximum.accumulate(up)
        columns.append(np.interp(-fine, up[seen], light[seen]))
    image = cv2.GaussianBlur(np.column_stack(columns).astype(np.float32), (0, 0), FINE * PSF_PX)
    image = image.reshape(size, FINE, size, FINE)[:, FINE // 2 - 1 : FINE // 2 + 1].mean(axis=1)
    image = image[..., FINE // 2 - 1 : FINE // 2 + 1].mean(axis=-1)
    up = np.array([[0.0, 0.0, 1.0]])
    reference, contrast = flat_terrain_brightness(up, sun, view[None], law)
    curvature = slope_curvature(up, sun, view[None], law)[0]
    to_image = radius_px * np.array([[1.0, 0.0, 0.0], [0.0, -np.cos(emission_rad), -np.sin(emission_rad)]])
    shading = RimShading(
        100.0, np.zeros(2), to_image @ contrast[0], to_image @ curvature @ to_image.T,
        to_image @ (sun * [1.0, 1.0, 0.0]), to_image @ (view * [1.0, 1.0, 0.0]), np.array([sun[2], view[2]]),
        share,
    )  # fmt: skip
    middle = 0.5 * (size - 1)
    axes = [middle, middle, radius_px, radius_px * np.cos(emission_rad), 0.0]
    return (100.0 / reference[0] * image).astype(np.float32), chart_of_axes(np.array(axes)), shading


def errors_px(image, chart, shading):
    """Shift of the rim along the ground towards the camera, and growth along and across that direction."""
    size, radius_px, flat = len(image), np.exp(chart[2]), np.exp(chart[4] - chart[2])
    camera = Camera(size, size, 1e3, 1e3, chart[0], chart[0], psf_sigma_px=PSF_PX)
    edges = find_edge_points(
        image, camera, chart, shading, radius_px * flat, 3.0, 0.0, EdgeOptions(), thorough=True
    )
    assert len(edges) > 0.8 * edges.tried > 30
    points = edges.at_level(smooth_share(own_share(edges.evidence, 0.6))).points_px - chart[:2]
    angle = np.arctan2(points[:, 1] / flat, points[:, 0])
    c, s = np.cos(angle), np.sin(angle)
    normal = np.column_stack([flat * c, s]) / np.hypot(flat * c, s)[:, None]
    on_rim = radius_px * np.column_stack([c, flat * s])
    off = np.sum((points - on_rim) * normal, axis=1)
    x, y = normal.T
    A = np.stack([flat * y, x, flat * y * s, x * c, x * s], axis=-1) / edges.sigma_ratio[:, None]
    found = np.linalg.lstsq(A, off / edges.sigma_ratio, rcond=None)[0]
    return found[[0, 2, 3]]
