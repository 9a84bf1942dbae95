"""Rendered images of the terrain: illumination, motion blur, optics and sensor noise."""

from contextlib import AbstractContextManager
from dataclasses import astuple, dataclass

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.camera import Camera
from craternav_fg.dataset.images import ImageArray
from craternav_fg.simulation import rays, sunlight
from craternav_fg.simulation.terrain import Levels, Terrain
from factors.arrays import FloatArray

Float32Array = npt.NDArray[np.float32]

# Points along each side of the image between which its motion is interpolated.
_MOTION_RASTER = 33
# Points along each side of the image whose rays bound the view.
_VIEW_RASTER = 17
# Distance that stands for infinity in the sky, m.
_SKY_M = 1e12
# The view is extended by this share of the height; rays count up to so many heights, and from half of one.
_VIEW_MARGIN, _LONGEST_RAY, _SHORTEST_RAY = 0.02, 25.0, 0.5
# The surface that bounds the view is at most at this share of the camera's altitude.
_HIGHEST_GROUND = 0.9
# Cosine of incidence that the exposure is set for when the sun is lower.
_MIN_COSINE = 0.01


@dataclass(frozen=True)
class Hapke:
    """Hapke's reflectance of a smooth surface: the roughness is that of the terrain.

    Attributes
    ----------
    single_scattering_albedo : float
        Share of the light that a grain scatters, above 0 and below 1.
    asymmetry : float
        Asymmetry of the Henyey-Greenstein phase function: below 0 the grains scatter back.
    opposition_amplitude, opposition_width : float
        B0 and h of the surge of brightness near zero phase.
    """

    single_scattering_albedo: float
    asymmetry: float
    opposition_amplitude: float
    opposition_width: float


@dataclass(frozen=True)
class RenderOptions:
    """Illumination, optics and sensor.

    Attributes
    ----------
    samples : int
        Rays along each side of a pixel; the cost grows with the square.
    lunar_lambert : float
        Share of the Lommel-Seeliger law; the rest is Lambert's.
    hapke : Hapke or None
        Law in place of Lunar-Lambert.
    sun_radius_rad : float
        Half the angle under which the sun appears: the softness of shadows.
    flat_level_share : float
        Brightness of locally flat terrain at the site, seen from above, as a share of full scale.
    psf_sigma_px : float
        Gaussian blur of the optics; 0 for none.
    vignetting_share : float
        Share of the light that is lost in the image's corners; it grows with the square of the distance from
        the centre.
    full_well_e : float
        Electrons at full scale: fewer give more shot noise; 0 for no noise.
    read_noise_e : float
        Standard deviation of the read-out noise in electrons.
    """

    samples: int = 1
    lunar_lambert: float = 0.55
    hapke: Hapke | None = None
    sun_radius_rad: float = 0.00465
    flat_level_share: float = 0.4
    psf_sigma_px: float = 0.7
    vignetting_share: float = 0.0
    full_well_e: float = 15000.0
    read_noise_e: float = 20.0


class Renderer:
    """Takes images of a terrain with a camera.

    Parameters
    ----------
    camera : Camera
        With its mounting and its lens.
    terrain : Terrain
    options : RenderOptions
    """

    def __init__(self, camera: Camera, terrain: Terrain, options: RenderOptions) -> None:
        self.camera = camera
        self.terrain = terrain
        self.options = options
        hapke = (0.0,) * 4 if options.hapke is None else astuple(options.hapke)
        self._law = np.array([options.lunar_lambert, *hapke])
        n = options.samples
        x = (np.arange(n * camera.width_px) + 0.5) / n - 0.5
        y = (np.arange(n * camera.height_px) + 0.5) / n - 0.5
        points = camera.normalised(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
        # Rays of a tile meet near each other, whichever way the camera is turned.
        self._order = rays.tiles(n * camera.width_px, n * camera.height_px)
        self._points = points[self._order]

    def render(
        self,
        gTb: FloatArray,
        sun_g: FloatArray,
        rng: np.random.Generator,
        sweep: tuple[FloatArray, FloatArray] | None = None,
    ) -> ImageArray:
        """Render the image from a pose of the lander.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Pose of the lander in g.
        sun_g : ndarray, shape (3,)
            Unit vector towards the sun in g.
        rng : Generator
            Sensor noise.
        sweep : tuple of ndarray, shape (4, 4), optional
            Poses in g at the beginning and the end of the exposure, whose middle is at `gTb`: the image is
            blurred by the motion between them.

        Returns
        -------
        ndarray of uint8 or uint16, shape (height_px, width_px)
            Grey levels up to the camera's full scale.
        """
        return self.expose(self.light(gTb, sun_g, sweep), sun_g, rng)

    def light(
        self, gTb: FloatArray, sun_g: FloatArray, sweep: tuple[FloatArray, FloatArray] | None = None
    ) -> Float32Array:
        """Brightness before optics and sensor, blurred by motion: the part of `render` that takes long.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Pose of the lander in g.
        sun_g : ndarray, shape (3,)
            Unit vector towards the sun in g.
        sweep : tuple of ndarray, shape (4, 4), optional
            See `render`.

        Returns
        -------
        ndarray of float32, shape (height_px, width_px)
            1 for a white surface below the sun.
        """
        light = self.radiance(gTb, sun_g)
        return light if sweep is None else self._swept(light, gTb, *sweep)

    def expose(self, light: Float32Array, sun_g: FloatArray, rng: np.random.Generator) -> ImageArray:
        """Image that optics and sensor make of `light`; it may run beside the next image's `light`.

        Parameters
        ----------
        light : ndarray of float32, shape (height_px, width_px)
            Brightness, dimensionless: 1 for a white surface below the sun.
        sun_g : ndarray, shape (3,)
            Unit vector towards the sun in g.
        rng : Generator
            Sensor noise.

        Returns
        -------
        ndarray of uint8 or uint16, shape (height_px, width_px)
            Grey levels up to the camera's full scale.
        """
        options = self.options
        if options.psf_sigma_px > 0.0:
            blurred = cv2.GaussianBlur(light, (0, 0), options.psf_sigma_px, borderType=cv2.BORDER_REPLICATE)
            light = blurred.astype(np.float32, copy=False)
        mu0 = max(float(sun_g @ self.terrain.relief.gRs[:, 2]), _MIN_COSINE)
        flat = mu0 * sunlight.reflectance(mu0, 1.0, mu0, self._law)
        signal = light * np.float32(options.flat_level_share / flat)
        if options.vignetting_share > 0.0:
            signal *= self._transmission()
        if options.full_well_e > 0.0:
            electrons = signal * np.float32(options.full_well_e)
            sigma = np.sqrt(np.minimum(electrons, options.full_well_e) + options.read_noise_e**2)
            electrons += sigma * rng.standard_normal(electrons.shape, dtype=np.float32)
            signal = electrons / np.float32(options.full_well_e)
        full_scale = self.camera.full_scale
        grey = np.clip(np.rint(full_scale * signal), 0.0, full_scale)
        return grey.astype(np.uint8) if self.camera.bit_depth == 8 else grey.astype(np.uint16)

    def radiance(self, gTb: FloatArray, sun_g: FloatArray) -> Float32Array:
        """Brightness before optics and sensor; 1 for a white surface below the sun.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Pose of the lander in g.
        sun_g : ndarray, shape (3,)
            Unit vector towards the sun in g.

        Returns
        -------
        ndarray of float32, shape (height_px, width_px)
        """
        camera, n = self.camera, self.options.samples
        _, P = self._camera_pose(gTb)
        sun = self.terrain.relief.gRs.T @ np.asarray(sun_g, dtype=np.float64)
        with self._levels(gTb) as levels:
            hits = self._hits(gTb, self._points, levels)
            tiled = np.empty(len(hits), np.float32)

            def work(lo: int, hi: int) -> None:
                sunlight.shade(
                    P, hits[lo:hi], sun, self.options.sun_radius_rad, self._law,
                    levels.heights_m, levels.slots, levels.frames_m, self.terrain.body.radius_m,
                    levels.top_m, levels.slope, tiled[lo:hi],
                )  # fmt: skip

            self.terrain.run(work, len(hits))
        light = np.empty_like(tiled)
        light[self._order] = tiled
        image = light.reshape(camera.height_px, n, camera.width_px, n)
        return np.ascontiguousarray(image.mean(axis=(1, 3)) if n > 1 else image[:, 0, :, 0])

    def ground_points(self, gTb: FloatArray, points_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points at which rays through pixels meet the rendered terrain, and its normals there.

        Parameters
        ----------
        gTb : ndarray, shape (4, 4)
            Pose of the lander in g.
        points_px : ndarray, shape (n, 2)
            Pixels, with fractions.

        Returns
        -------
        points, normals : ndarray, shape (n, 3)
            In g, m, and unit length; NaN in the sky.
        """
        at = self.camera.normalised(np.asarray(points_px, dtype=np.float64))
        points, normals = np.empty((len(at), 3)), np.empty((len(at), 3))
        with self._levels(gTb) as levels:
            rays.surfaces(
                self._hits(gTb, at, levels), levels.heights_m, levels.slots, levels.frames_m,
                self.terrain.body.radius_m, points, normals,
            )  # fmt: skip
        gRs = self.terrain.relief.gRs
        return points @ gRs.T, normals @ gRs.T

    def _swept(
        self, light: Float32Array, gTb: FloatArray, begin: FloatArray, end: FloatArray
    ) -> Float32Array:
        """Mean of an image over the motion between two poses, with locally flat terrain around each pixel."""
        camera = self.camera
        x = np.linspace(0.0, camera.width_px - 1.0, _MOTION_RASTER)
        y = np.linspace(0.0, camera.height_px - 1.0, _MOTION_RASTER)
        raster = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        ground, _ = self.ground_points(gTb, raster)
        gTc = camera.gTc(gTb)
        rays_c = np.concatenate([camera.normalised(raster), np.ones((len(raster), 1))], axis=1)
        sky = np.isnan(ground[:, 0])
        ground[sky] = gTc[:3, 3] + _SKY_M * rays_c[sky] @ gTc[:3, :3].T
        ends = []
        for pose in (begin, end):
            T = camera.gTc(pose)
            ends.append(camera.project((ground - T[:3, 3]) @ T[:3, :3]))
        motion = (ends[1] - ends[0]).reshape(_MOTION_RASTER, _MOTION_RASTER, 2)
        # The raster's outermost points are the centres of the outermost pixels.
        u = np.linspace(0.0, _MOTION_RASTER - 1.0, camera.width_px, dtype=np.float32)
        v = np.linspace(0.0, _MOTION_RASTER - 1.0, camera.height_px, dtype=np.float32)
        field = cv2.remap(motion.astype(np.float32), *np.meshgrid(u, v), cv2.INTER_LINEAR)
        column, row = np.meshgrid(
            np.arange(camera.width_px, dtype=np.float32), np.arange(camera.height_px, dtype=np.float32)
        )
        steps = int(np.ceil(2.0 * np.linalg.norm(motion, axis=-1).max())) + 1
        total = np.zeros_like(light)
        for share in (np.arange(steps, dtype=np.float32) + 0.5) / steps - 0.5:
            total += cv2.remap(
                light, column - share * field[..., 0], row - share * field[..., 1], cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REPLICATE,
            )  # fmt: skip
        # Cubic interpolation overshoots below black beside shadows.
        return np.maximum(total / np.float32(steps), 0.0)

    def _transmission(self) -> Float32Array:
        """Share of the light that reaches each pixel (height_px, width_px)."""
        camera = self.camera
        x = (np.arange(camera.width_px) - camera.cx_px) / camera.width_px
        y = (np.arange(camera.height_px) - camera.cy_px) / camera.height_px
        share = 2.0 * (x[None, :] ** 2 + y[:, None] ** 2)
        return np.maximum(1.0 - self.options.vignetting_share * share, 0.0).astype(np.float32)

    def _camera_pose(self, gTb: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotation (3, 3) and position (3,), m, of the camera in the site frame."""
        gTc = self.camera.gTc(np.asarray(gTb, dtype=np.float64))
        sRg = self.terrain.relief.gRs.T
        return np.ascontiguousarray(sRg @ gTc[:3, :3]), np.ascontiguousarray(sRg @ gTc[:3, 3])

    def _hits(self, gTb: FloatArray, points: FloatArray, levels: Levels) -> FloatArray:
        R, P = self._camera_pose(gTb)
        points = np.ascontiguousarray(points)
        hits = np.empty((len(points), 2))

        def work(lo: int, hi: int) -> None:
            rays.trace(
                P, R, points[lo:hi], levels.heights_m, levels.slots, levels.frames_m,
                self.terrain.body.radius_m, levels.top_m, levels.slope, hits[lo:hi],
            )  # fmt: skip

        self.terrain.run(work, len(points))
        return hits

    def _levels(self, gTb: FloatArray) -> AbstractContextManager[Levels]:
        """Grids for the view from a pose: a coarse raster of rays on a sphere bounds what is seen."""
        camera = self.camera
        R, P = self._camera_pose(gTb)
        sphere = self.terrain.body.radius_m
        # At the height of the terrain, which a catalogue may set far below or above the reference sphere.
        altitude = float(np.linalg.norm(P)) - sphere
        below = sphere * P[:2] / P[2]
        ground_m = self.terrain.lift_m(below) + float(self.terrain.relief.base_m(below[None])[0])
        radius = sphere + min(ground_m, _HIGHEST_GROUND * altitude)
        x = np.linspace(-0.5, camera.width_px - 0.5, _VIEW_RASTER)
        y = np.linspace(-0.5, camera.height_px - 0.5, _VIEW_RASTER)
        uv = camera.normalised(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
        directions = np.concatenate([uv, np.ones((len(uv), 1))], axis=1)
        directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)) @ R.T
        pd = directions @ P
        root = pd**2 - P @ P + radius**2
        height = np.linalg.norm(P) - radius
        # Rays that miss the body also bound the view: they end where they are closest to it.
        distance = np.where(root >= 0.0, -pd - np.sqrt(np.maximum(root, 0.0)), -pd)
        distance = np.clip(distance, _SHORTEST_RAY * height, _LONGEST_RAY * height)
        ground = P + distance[:, None] * directions
        plane = sphere * ground[:, :2] / ground[:, 2:]
        closest = int(np.argmin(distance))
        margin = _VIEW_MARGIN * height
        return self.terrain.levels(
            plane.min(axis=0) - margin,
            plane.max(axis=0) + margin,
            plane[closest],
            float(distance[closest]) / camera.focal_px,
        )
