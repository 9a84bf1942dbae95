"""The simulated world of a scenario: trajectory, sun, terrain and craters, without any error of a sensor."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.model import Catalog
from craternav_fg.catalogs.nested_dem import read_nested_dem
from craternav_fg.dataset import SunVectors
from craternav_fg.errors import CraternavError
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from craternav_fg.simulation.orbit import Orbit
from craternav_fg.simulation.published import published_craters, unresolved_craters
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Hapke, Renderer, RenderOptions
from craternav_fg.simulation.scenario_file import Scenario
from craternav_fg.simulation.scenario_tables import (
    Crater,
    CraterFile,
    CraterList,
    PublishedCraters,
    RandomCraters,
    RenderSection,
    TerrainSection,
    TrajectorySection,
)
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from craternav_fg.simulation.trajectory import Descent, Track
from factors.arrays import FloatArray

AnyCraters = RandomCraters | CraterFile | CraterList | PublishedCraters

# Stored directions towards the sun are interpolated; it moves by less than 0.005 deg in this time.
SUN_INTERVAL_NS = 10_000_000_000


@dataclass(frozen=True)
class World:
    """A scenario's descent and what is seen on it.

    Attributes
    ----------
    scenario : Scenario
    descent : Track
    camera : Camera
        With its true mounting.
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames.
    sun : SunVectors
    relief : Relief or None
        None where the scenario has no terrain.
    catalog : Catalog
        True craters; with published ones the map, whose rims are not quite those of the terrain.
    clutter : Catalog or None
        Craters of the terrain that the catalogue does not have.
    """

    scenario: Scenario
    descent: Track
    camera: Camera
    stamps_ns: npt.NDArray[np.int64]
    sun: SunVectors
    relief: Relief | None
    catalog: Catalog
    clutter: Catalog | None

    def renderer(self) -> Renderer:
        """Make the renderer of the scenario's images."""
        terrain, light = self.scenario.terrain, self.scenario.render
        assert self.relief is not None
        assert terrain is not None
        assert light is not None
        ground = Terrain(self._standing(), self.relief, terrain_options(terrain), self.clutter)
        return Renderer(self.camera, ground, render_options(light))

    def _standing(self) -> Catalog:
        """Craters that the terrain gets beside those of its elevation model."""
        published = isinstance(self.scenario.craters, PublishedCraters)
        return self.catalog.take(np.empty(0, dtype=np.int64)) if published else self.catalog


def terrain_options(section: TerrainSection) -> TerrainOptions:
    """Read how a scenario's craters are worn and shaped.

    Parameters
    ----------
    section : TerrainSection

    Returns
    -------
    TerrainOptions
    """
    return TerrainOptions(
        depth_scatter_share=section.depth_scatter_share,
        irregularity_share=section.irregularity_share,
        degradation=section.degradation,
        peaks_from_m=math.inf if section.peaks_from_m is None else section.peaks_from_m,
    )


def render_options(section: RenderSection) -> RenderOptions:
    """Read how a scenario's images are rendered.

    Parameters
    ----------
    section : RenderSection

    Returns
    -------
    RenderOptions
    """
    same = section.model_dump(exclude={"sun_radius_deg", "bit_depth", "exposure_s", "hapke"})
    hapke = None if section.hapke is None else Hapke(**section.hapke.model_dump())
    return RenderOptions(sun_radius_rad=math.radians(section.sun_radius_deg), hapke=hapke, **same)


def make_world(scenario: Scenario, rng: np.random.Generator, *, trial: bool) -> World:
    """Make the world of a scenario.

    Parameters
    ----------
    scenario : Scenario
    rng : Generator
        Terrain and craters.
    trial : bool
        Whether this is a trial of a Monte Carlo campaign: listed craters are then redrawn if the list
        says so.

    Returns
    -------
    World

    Raises
    ------
    InputError
        When the scenario's crater file or elevation model is wrong.
    CraternavError
        When the trajectory leads into the ground.
    """
    body = scenario.body.body()
    try:
        stamps = frame_stamps(scenario.trajectory, scenario.faults.outages_s)
        descent = _track(scenario, body, stamps, rng)
    except ValueError as error:
        raise CraternavError(f"scenario: [trajectory]: {error}") from None
    track = descent.evaluate(np.multiply(stamps, 1e-9)).gP
    relief = _relief(scenario, body, rng)
    if relief is not None and relief.dem is not None:
        up = track / np.linalg.norm(track, axis=1, keepdims=True)
        clear_m = float(np.min(body.altitude_m(track) - relief.dem.heights_m(up)))
        if clear_m <= 0.0:
            problem = f"the descent leads {-clear_m:.0f} m below the elevation model"
            raise CraternavError(f"scenario: [trajectory]: {problem}")
    if trial:
        scenario = scenario.model_copy(update={"craters": trial_craters(scenario.craters, rng)})
    catalog, clutter = _craters(scenario, body, track, relief, rng)
    sun = sun_vectors(scenario, body, int(stamps[-1]))
    return World(scenario, descent, _camera(scenario), stamps, sun, relief, catalog, clutter)


def _track(scenario: Scenario, body: Body, stamps: npt.NDArray[np.int64], rng: np.random.Generator) -> Track:
    """Make the true motion: a descent, or what a motion model does from the trajectory's start."""
    if scenario.motion is None:
        return Descent(body, scenario.trajectory)
    return Orbit(body, scenario.trajectory, scenario.motion.motion(body, Path()), stamps, rng)


def trial_craters(craters: AnyCraters, rng: np.random.Generator) -> AnyCraters:
    """Draw the craters of one trial: those of a list with `trials` again, all others unchanged."""
    if not isinstance(craters, CraterList) or craters.trials is None:
        return craters
    n = len(craters.crater)
    east, north = rng.normal(scale=craters.trials.place_sigma_m, size=(2, n))
    axes = np.sort(rng.uniform(*craters.trials.semi_axes_m, size=(n, 2)), axis=1)
    angles = rng.uniform(0.0, 180.0, size=n)
    drawn = tuple(
        crater.model_copy(
            update={
                "east_m": crater.east_m + float(east[k]),
                "north_m": crater.north_m + float(north[k]),
                "semi_major_m": float(axes[k, 1]),
                "semi_minor_m": float(axes[k, 0]),
                "angle_deg": float(angles[k]),
            }
        )
        for k, crater in enumerate(craters.crater)
    )
    return craters.model_copy(update={"crater": drawn})


def frame_stamps(
    options: TrajectorySection, outages_s: Sequence[tuple[float, float]] = ()
) -> npt.NDArray[np.int64]:
    """Stamps of the images, from 0 to the end of the descent, without those in outages.

    Parameters
    ----------
    options : TrajectorySection
    outages_s : sequence of tuple of float
        Beginnings and ends.

    Returns
    -------
    ndarray of int, shape (k,)
        Nanoseconds; the first image is always there.
    """
    count = math.floor(options.duration_s / options.frame_interval_s + 1e-9) + 1
    seconds = np.arange(count) * options.frame_interval_s
    lost = np.zeros(count, dtype=np.bool_)
    for begin, end in outages_s:
        lost |= (seconds >= begin) & (seconds < end)
    lost[0] = False
    return np.round(seconds[~lost] * 1e9).astype(np.int64)


def sun_vectors(scenario: Scenario, body: Body, end_ns: int) -> SunVectors:
    """Directions towards the sun in g from 0 to the end; the sun is fixed inertially."""
    elevation, azimuth = math.radians(scenario.sun.elevation_deg), math.radians(scenario.sun.azimuth_deg)
    level = math.cos(elevation)
    enu = np.array([level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation)])
    stamps = np.append(np.arange(0, end_ns, SUN_INTERVAL_NS, dtype=np.int64), end_ns)
    return SunVectors.among_stars(_site(scenario.trajectory) @ enu, 0, stamps, body.spin_rad_s)


def _camera(scenario: Scenario) -> Camera:
    """Return the camera with the blur and the bit depth that the data set states."""
    camera, render = scenario.camera.camera(), scenario.render
    if render is None:
        return camera
    # Averaging over a pixel's samples blurs by their standard deviation.
    pixel_px = math.sqrt((1.0 - render.samples**-2) / 12.0)
    return replace(camera, psf_sigma_px=math.hypot(render.psf_sigma_px, pixel_px), bit_depth=render.bit_depth)


def _relief(scenario: Scenario, body: Body, rng: np.random.Generator) -> Relief | None:
    terrain = scenario.terrain
    if terrain is None:
        return None
    options = ReliefOptions(
        slope=terrain.slope,
        hurst=terrain.hurst,
        coarsest_m=terrain.coarsest_m,
        seed=int(rng.integers(2**31)),
    )
    models = [Path(path) for path in terrain.models()]
    dem = read_nested_dem(models, terrain.dem_unit_m, body.radius_m) if models else None
    return Relief(body, _site(scenario.trajectory)[:, 2], options, dem)


def _craters(
    scenario: Scenario, body: Body, track: FloatArray, relief: Relief | None, rng: np.random.Generator
) -> tuple[Catalog, Catalog | None]:
    """Craters of the catalogue, and those of the terrain that it does not have."""
    match scenario.craters:
        case RandomCraters() as random:
            assert relief is not None
            options = CraterFieldOptions(
                focal_px=scenario.camera.camera().focal_px, **random.model_dump(exclude={"source"})
            )
            catalog = random_craters(rng, body, track, options, relief)
            if scenario.render is None:
                return catalog, None
            return catalog, random_clutter(rng, body, track, options, catalog)
        case CraterFile() as file:
            catalog = import_catalog(Path(file.path), body)[0]
            if scenario.render is not None and np.any(catalog.tilts_rad()):
                raise CraternavError(
                    f"{file.path}: expected level rims, found tilted planes; rendered rims are level"
                )
            return catalog, None
        case PublishedCraters() as published:
            assert relief is not None
            assert scenario.terrain is not None
            focal_px = scenario.camera.camera().focal_px
            return (
                published_craters(published, body, track, scenario.terrain.dem_unit_m),
                unresolved_craters(rng, published, body, track, focal_px, relief),
            )
        case CraterList() as named:
            return _named_craters(named.crater, _site(scenario.trajectory), body), None


def _named_craters(craters: Sequence[Crater], gRe: FloatArray, body: Body) -> Catalog:
    places = np.array([[c.east_m, c.north_m, body.radius_m] for c in craters])
    lat, lon = frames.latitude_longitude(places @ gRe.T)
    return Catalog(
        identifiers=tuple(f"C{i + 1}" for i in range(len(craters))),
        latitude_rad=lat,
        longitude_rad=lon,
        semi_major_m=np.array([c.semi_major_m for c in craters]),
        semi_minor_m=np.array([c.semi_minor_m for c in craters]),
        angle_rad=np.radians([c.angle_deg for c in craters]),
        height_m=np.array([c.height_m for c in craters]),
        body=body,
        plane_tilt_rad=np.zeros((len(craters), 2)),
    )


def _site(options: TrajectorySection) -> FloatArray:
    return frames.east_north_up(np.radians(options.site_latitude_deg), np.radians(options.site_longitude_deg))
