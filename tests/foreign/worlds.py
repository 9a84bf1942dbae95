"""Worlds: kinds of ground, light and optics, drawn for each descent."""

from dataclasses import dataclass

import numpy as np

from factors.arrays import FloatArray
from tests.foreign.ground import Ground, GroundKind, make_ground
from tests.foreign.images import ImageArray, Optics, Photographer
from tests.foreign.motion import BODY_CAMERA, Motion, Site, draw_motion

LAWS = ("lambert", "lommel-seeliger", "minnaert")
HIGH_M, LOW_M, DURATION_S, FRAMES = 5000.0, 3000.0, 60.0, 16
_SIDE, _CELL_M, _SIZES_M, _CRATERS = 1000, 4.8, (170.0, 480.0), 40

KINDS = {
    "gentle": GroundKind(0.03, 0.02, 0.0, (0.0, 0.4), 2.0, 0.02),
    "worn": GroundKind(0.03, 0.03, 0.004, (0.6, 1.0), 2.0, 0.03),
    "rough": GroundKind(0.10, 0.05, 0.006, (0.1, 0.8), 4.0, 0.05),
    "patchy": GroundKind(0.05, 0.03, 0.003, (0.0, 0.6), 3.0, 0.12),
}


@dataclass(frozen=True)
class World:
    """One descent: the ground, the sun in the tangent frame, the motion and the camera."""

    kind: str
    law: str
    optics: Optics
    ground: Ground
    sun: FloatArray
    motion: Motion
    times_s: FloatArray
    images: list[ImageArray]


def draw_world(
    seed: int,
    kind: str,
    optics: Optics | None = None,
    frames: int = FRAMES,
    ground: GroundKind | None = None,
    sun_deg: float | None = None,
) -> World:
    """Draw and render a descent, over the kind's ground or another; takes some seconds.

    The sun is 22 to 50 deg high, or `sun_deg`.
    """
    rng = np.random.default_rng([seed, sorted(KINDS).index(kind)])
    law = LAWS[int(rng.integers(len(LAWS)))]
    drawn_deg, azimuth = rng.uniform(22.0, 50.0), rng.uniform(0.0, 2.0 * np.pi)
    height = np.radians(drawn_deg if sun_deg is None else sun_deg)
    sun = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
    site = Site.at(*np.radians([rng.uniform(-40.0, 40.0), rng.uniform(-180.0, 180.0)]))
    motion = draw_motion(rng, site, HIGH_M, LOW_M, DURATION_S)
    drawn = Optics(
        psf_px=float(rng.uniform(0.4, 1.1)), gamma=float(rng.choice([1.0, 0.9])),
        jpeg=None if rng.uniform() < 0.7 else 92, vignetting=float(rng.uniform(0.0, 0.25)),
        noise=float(rng.uniform(0.5, 2.0)),
    )  # fmt: skip
    made = make_ground(rng, ground or KINDS[kind], _SIDE, _CELL_M, _SIZES_M, _CRATERS)
    photographer = Photographer(made, sun, law, optics or drawn)
    times_s = np.linspace(0.0, DURATION_S, frames)
    images = [photographer.take(rng, motion.position(t), motion.attitude(t) @ BODY_CAMERA) for t in times_s]
    return World(kind, law, optics or drawn, made, sun, motion, times_s, images)
