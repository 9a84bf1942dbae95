"""From a scenario to a data set on disk."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.ground import ground_heights
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import SunVectors, write_dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.errors import CraternavError
from craternav_fg.imu import ImuLog
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.sensors.protocol import Sensor, Surroundings
from craternav_fg.simulation import faults, sensors
from craternav_fg.simulation.craters import CraterFieldOptions, random_clutter, random_craters
from craternav_fg.simulation.other_sensors import simulate_sensors
from craternav_fg.simulation.relief import Relief, ReliefOptions
from craternav_fg.simulation.render import Hapke, Renderer, RenderOptions
from craternav_fg.simulation.scenario_file import (
    Crater,
    CraterFile,
    CraterList,
    MeasurementSection,
    RandomCraters,
    Scenario,
    TrajectorySection,
)
from craternav_fg.simulation.terrain import Terrain, TerrainOptions
from craternav_fg.simulation.trajectory import Descent
from craternav_fg.trajectory import Trajectory

FloatArray = npt.NDArray[np.float64]
AnyCraters = RandomCraters | CraterFile | CraterList

SUN_INTERVAL_NS = 10_000_000_000


def simulate(
    scenario: Scenario,
    folder: Path,
    *,
    trial: int | None = None,
    with_initial: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Simulate a descent and write its data set.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        Replaced when it is empty or a data set.
    trial : int, optional
        Number of a Monte Carlo trial: with the scenario's seed it determines all randomness; listed
        craters are then drawn anew if the list says so.
    with_initial : bool
        Whether the data set says where the descent begins.
    progress : callable, optional
        Called with the frames done and their number.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        When the folder holds something else, or the scenario's crater file or elevation model is wrong.
    CraternavError
        When the trajectory leads into the ground.
    """
    seed = np.random.SeedSequence(scenario.seed, spawn_key=() if trial is None else (trial,))
    # One stream per subject, so that a change in one leaves the others as they were.
    streams = (np.random.default_rng(s) for s in seed.spawn(6))
    crater_rng, imu_rng, initial_rng, frame_rng, fault_rng, sensor_rng = streams
    body, camera = scenario.body.body(), _camera(scenario)
    try:
        descent = Descent(body, scenario.trajectory)
    except ValueError as error:
        raise CraternavError(f"scenario: [trajectory]: {error}") from None
    stamps = frame_stamps(scenario.trajectory, scenario.faults.outages_s)
    motion = descent.evaluate(np.multiply(stamps, 1e-9))
    sun = sun_vectors(scenario, body, int(stamps[-1]))
    relief = _relief(scenario, body, crater_rng)
    if relief is not None and relief.dem is not None:
        clear_m = float(np.min(body.altitude_m(motion.gP) - relief.dem.heights_m(motion.gP)))
        if clear_m <= 0.0:
            problem = f"the descent leads {-clear_m:.0f} m below the elevation model"
            raise CraternavError(f"scenario: [trajectory]: {problem}")
    if trial is not None:
        scenario = scenario.model_copy(update={"craters": trial_craters(scenario.craters, crater_rng)})
    catalog, clutter = _craters(scenario, body, motion.gP, relief, crater_rng)

    ideal = sensors.ideal_imu(descent, sensors.imu_stamps(scenario.imu, 0, int(stamps[-1])), 0)
    imu, bias = sensors.corrupt_imu(ideal, scenario.imu, imu_rng)
    initial = sensors.initial_state(
        motion.gTb[0], motion.gV[0], int(stamps[0]), scenario.initial_error, scenario.imu, initial_rng
    )
    exposed_s = np.multiply(stamps, 1e-9) + scenario.faults.image_delay_s
    poses = descent.evaluate(exposed_s).gTb
    surroundings = Surroundings(body, ground_heights(catalog))
    others = simulate_sensors(
        scenario.sensors, descent, surroundings, int(stamps[0]), int(stamps[-1]), sensor_rng
    )
    told = faults.perturb_map(catalog, scenario.faults, fault_rng)

    def done(frame: int) -> None:
        if progress is not None:
            progress(frame + 1, len(stamps))

    def images() -> Iterator[ImageArray]:
        assert relief is not None
        assert scenario.render is not None
        renderer = _renderer(scenario, camera, catalog, relief, clutter)
        half_s = 0.5 * scenario.render.exposure_s
        begin, end = (descent.evaluate(exposed_s + side).gTb for side in (-half_s, half_s))
        for k, stamp in enumerate(stamps.tolist()):
            sweep = (begin[k], end[k]) if half_s > 0.0 else None
            yield renderer.render(poses[k], sun.at(stamp), frame_rng, sweep)
            done(k)

    def rims(options: MeasurementSection) -> Iterator[FrameMeasurement]:
        for k, stamp in enumerate(stamps.tolist()):
            frame = sensors.measure(
                poses[k],
                stamp,
                sun.at(stamp),
                camera=camera,
                catalog=catalog,
                prior_gP=initial.gTb[:3, 3],
                options=options,
                rng=frame_rng,
            )
            yield faults.swap_matches(frame, catalog, scenario.faults, fault_rng)
            done(k)

    return write_dataset(
        folder,
        body=body,
        camera=faults.perturb_mounting(camera, scenario.faults, fault_rng),
        catalog=told,
        imu=imu,
        imu_noise=scenario.imu.noise(),
        initial=initial if with_initial else None,
        sun=sun,
        stamps_ns=stamps,
        images=None if scenario.render is None else images(),
        measurements=None if scenario.measurements is None else list(rims(scenario.measurements)),
        sensors=others,
        truth=_truth(descent, imu, bias, stamps, others),
    )


def _truth(
    descent: Descent, imu: ImuLog, bias: FloatArray, stamps: npt.NDArray[np.int64], others: Sequence[Sensor]
) -> Trajectory:
    """Truth at the frames and at the sensors' samples, which the bound needs."""
    every = np.unique(np.concatenate([stamps, *(sensor.stamps_ns for sensor in others)]))
    motion = descent.evaluate(np.multiply(every, 1e-9))
    return Trajectory(every, motion.gTb, motion.gV, bias[np.searchsorted(imu.stamps_ns, every)])


def trial_craters(craters: AnyCraters, rng: np.random.Generator) -> AnyCraters:
    """Craters of one trial: those of a list that varies drawn anew, all others as they are."""
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
    """Stamps of the images, from 0 to the end of the descent, without those in outages, ns."""
    count = math.floor(options.duration_s / options.frame_interval_s + 1e-9) + 1
    seconds = np.arange(count) * options.frame_interval_s
    lost = np.zeros(count, dtype=np.bool_)
    for begin, end in outages_s:
        lost |= (seconds >= begin) & (seconds < end)
    lost[0] = False
    return np.round(seconds[~lost] * 1e9).astype(np.int64)


def sun_vectors(scenario: Scenario, body: Body, end_ns: int) -> SunVectors:
    """Direction towards the sun, which is fixed inertially, from 0 to the end."""
    elevation, azimuth = math.radians(scenario.sun.elevation_deg), math.radians(scenario.sun.azimuth_deg)
    level = math.cos(elevation)
    enu = np.array([level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation)])
    stamps = np.append(np.arange(0, end_ns, SUN_INTERVAL_NS, dtype=np.int64), end_ns)
    turned = frames.rotation_exp(np.multiply.outer(-stamps * 1e-9, np.array(body.spin_rad_s)))
    return SunVectors(stamps, turned @ (_site(scenario.trajectory) @ enu))


def _camera(scenario: Scenario) -> Camera:
    """Give the camera with what the data set says of its images."""
    camera, render = scenario.camera.camera(), scenario.render
    if render is None:
        return camera
    # The mean over a pixel's samples blurs by their scatter.
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
    dem = None if terrain.dem is None else read_dem(Path(terrain.dem), terrain.dem_unit_m, body.radius_m)
    return Relief(body, _site(scenario.trajectory)[:, 2], options, dem)


def _craters(
    scenario: Scenario, body: Body, track: FloatArray, relief: Relief | None, rng: np.random.Generator
) -> tuple[Catalog, Catalog | None]:
    """Craters of the catalogue, and those that only the ground has."""
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
            return import_catalog(Path(file.path), body)[0], None
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
    )


def _renderer(
    scenario: Scenario, camera: Camera, catalog: Catalog, relief: Relief, clutter: Catalog | None
) -> Renderer:
    assert scenario.terrain is not None
    assert scenario.render is not None
    ground = scenario.terrain
    options = TerrainOptions(
        depth_scatter=ground.depth_scatter,
        irregularity=ground.irregularity,
        degradation=ground.degradation,
        peaks_from_m=math.inf if ground.peaks_from_m is None else ground.peaks_from_m,
    )
    terrain = Terrain(catalog, relief, options, clutter)
    light = scenario.render
    options_given = light.model_dump(exclude={"sun_radius_deg", "bit_depth", "exposure_s", "hapke"})
    hapke = None if light.hapke is None else Hapke(**light.hapke.model_dump())
    sun_radius_rad = math.radians(light.sun_radius_deg)
    return Renderer(
        camera, terrain, RenderOptions(sun_radius_rad=sun_radius_rad, hapke=hapke, **options_given)
    )


def _site(options: TrajectorySection) -> FloatArray:
    return frames.east_north_up(np.radians(options.site_latitude_deg), np.radians(options.site_longitude_deg))
