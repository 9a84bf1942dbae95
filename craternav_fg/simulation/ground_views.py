"""Single images of the real ground of a scenario, from random poses above it under a random sun."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.nested_dem import read_nested_dem
from craternav_fg.errors import CraternavError
from craternav_fg.simulation.published import unresolved_craters
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Renderer
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.simulation.scenario_tables import PublishedCraters, RenderSection, TerrainSection
from craternav_fg.simulation.scenes import sun_direction
from craternav_fg.simulation.terrain import Terrain
from craternav_fg.simulation.world import render_options, terrain_options
from factors.arrays import FloatArray

# Lowest and highest altitude above the ground; their logarithms are uniform.
ALTITUDES_M = (60e3, 200e3)
# Least and greatest elevation of the sun, and tilt of the camera from nadir.
SUN_DEG, TILT_DEG = (10.0, 70.0), (0.0, 20.0)
# Largest distance of the site from the finest elevation model's middle, along meridian and parallel.
REACH_DEG = 2.5


class GroundView(NamedTuple):
    """An image of real ground."""

    image: npt.NDArray[np.uint8]
    """Grey levels, shape (H, W)."""
    gTb: FloatArray
    """True pose of body and camera, shape (4, 4)."""
    altitude_m: float
    """Above the ground below the camera."""
    sun_deg: float
    """Elevation of the sun at the site."""


class RealGround:
    """The ground of a scenario with an elevation model and a published catalogue.

    Parameters
    ----------
    name : str or Path
        Scenario.
    data : Path, optional
        Folder of the public files, see `Scenario.with_data`.

    Raises
    ------
    InputError
        When a file is missing or wrong.
    CraternavError
        When the scenario has no elevation model, published catalogue or images.
    """

    def __init__(self, name: str | Path, data: Path | None = None) -> None:
        scenario = load_scenario(name).with_data(data)
        terrain, craters, light = scenario.terrain, scenario.craters, scenario.render
        real = terrain is not None and terrain.models() and light is not None
        if not real or not isinstance(craters, PublishedCraters):
            raise CraternavError(f"{name}: expected an elevation model, a published catalogue and images")
        assert isinstance(terrain, TerrainSection)
        assert isinstance(light, RenderSection)
        self.body: Body = scenario.body.body()
        # At the body's origin, axes as the body's.
        self.camera: Camera = replace(scenario.camera.camera(), bTc=np.eye(4))
        self._terrain, self._craters, self._light = terrain, craters, light
        models = [Path(path) for path in terrain.models()]
        self._dem = read_nested_dem(models, terrain.dem_unit_m, self.body.radius_m)

    @property
    def middle(self) -> FloatArray:
        """Unit vector (3,) in g to the middle of the finest elevation model."""
        return self._dem.models[0].middle

    def view(self, rng: np.random.Generator) -> GroundView:
        """Take an image.

        Parameters
        ----------
        rng : Generator
            Pose, sun, roughness, craters below the model's resolution, and sensor noise.

        Returns
        -------
        GroundView
        """
        latitude, longitude = frames.latitude_longitude(self.middle)
        off = np.radians(rng.uniform(-REACH_DEG, REACH_DEG, 2))
        site = frames.east_north_up(latitude + off[0], longitude + off[1] / np.cos(latitude))
        sun_deg = float(rng.uniform(*SUN_DEG))
        sun_g = sun_direction(site, np.radians(sun_deg), rng.uniform(0.0, 2.0 * np.pi))
        gTb = self._pose(rng, site)
        image = self._renderer(rng, site, gTb).render(gTb, sun_g, rng).astype(np.uint8, copy=False)
        return GroundView(image, gTb, self._altitude_m(gTb[:3, 3]), sun_deg)

    def _altitude_m(self, gP: FloatArray) -> float:
        below_m = self._dem.heights_m(gP[None] / np.linalg.norm(gP))[0]
        return float(np.linalg.norm(gP) - self.body.radius_m - below_m)

    def _pose(self, rng: np.random.Generator, site: FloatArray) -> FloatArray:
        """Draw a pose whose optical axis goes through the site."""
        altitude_m = np.exp(rng.uniform(*np.log(ALTITUDES_M)))
        toward, heading = rng.uniform(0.0, 2.0 * np.pi, 2)
        tilt = np.radians(rng.uniform(*TILT_DEG))
        axis = tilt * (site @ [np.cos(toward), np.sin(toward), 0.0])
        gRc = frames.rotation_exp(axis) @ site @ np.diag([1.0, -1.0, -1.0])
        gRc = gRc @ frames.rotation_exp(np.array([0.0, 0.0, heading]))
        ground_m = self.body.radius_m + self._dem.heights_m(site[None, :, 2])[0]
        return frames.pose(gRc, ground_m * site[:, 2] - gRc[:, 2] * altitude_m / np.cos(tilt))

    def _renderer(self, rng: np.random.Generator, site: FloatArray, gTb: FloatArray) -> Renderer:
        """Add roughness and craters that the elevation model does not resolve."""
        rough, light = self._terrain, self._light
        roughness = ReliefOptions(rough.slope, rough.hurst, rough.coarsest_m, int(rng.integers(2**31)))
        relief = Relief(self.body, site[:, 2], roughness, self._dem)
        track = gTb[None, :3, 3]
        small = unresolved_craters(rng, self._craters, self.body, track, self.camera.focal_px, relief)
        none = small.take(np.empty(0, dtype=np.int64))
        ground = Terrain(none, relief, terrain_options(rough), small)
        return Renderer(self.camera, ground, render_options(light))
