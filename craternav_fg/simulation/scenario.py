"""Simulation of a scenario: from its file to a data set on disk."""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt

from craternav_fg.catalogs.ground import ground_heights
from craternav_fg.dataset import Recording, write_dataset
from craternav_fg.dataset.images import ImageArray
from craternav_fg.imu import ImuLog
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.sensors.protocol import Sensor, Surroundings
from craternav_fg.simulation import faults, sensors
from craternav_fg.simulation.other_sensors import simulate_sensors, simulate_tracks
from craternav_fg.simulation.scenario_file import Scenario, load_scenario
from craternav_fg.simulation.terrain import VIEWS_AT_ONCE
from craternav_fg.simulation.trajectory import Track
from craternav_fg.simulation.world import World, make_world
from craternav_fg.trajectory import InitialState, Trajectory
from factors.arrays import FloatArray

Progress = Callable[[int, int], None]

# Prior standard deviation of an acceleration that a motion model has no state for.
UNUSED_SIGMA_M_S2 = 1e-3


def simulate(
    scenario: Scenario | Path | str,
    folder: Path | str,
    *,
    trial: int | None = None,
    with_initial: bool = True,
    progress: Progress | None = None,
) -> Path:
    """Simulate a descent and write its data set.

    Parameters
    ----------
    scenario : Scenario, Path or str
        Name of a built-in scenario, or a TOML file.
    folder : Path
        Replaced when it is empty or a data set.
    trial : int, optional
        Number of a Monte Carlo trial. With the scenario's seed, it determines all random numbers. Listed
        craters are redrawn if the list says so.
    with_initial : bool
        Whether the data set has an initial state.
    progress : callable, optional
        Called with the number of finished frames and the total.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        When the folder holds something else, or a file that the scenario names is missing or wrong.
    CraternavError
        When the trajectory leads into the ground.
    """
    case = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    scenario = case.with_data()
    seed = np.random.SeedSequence(scenario.seed, spawn_key=() if trial is None else (trial,))
    # One stream per subject: a change in one leaves the others as they were.
    streams = (np.random.default_rng(s) for s in seed.spawn(6))
    crater_rng, imu_rng, initial_rng, frame_rng, fault_rng, sensor_rng = streams
    world = make_world(scenario, crater_rng, trial=trial is not None)
    descent, stamps = world.descent, world.stamps_ns
    begin_ns, end_ns = int(stamps[0]), int(stamps[-1])

    imu, bias = _imu(world, imu_rng)
    motion = descent.evaluate(np.multiply(stamps, 1e-9))
    initial = sensors.initial_state(
        motion.gTb[0], motion.gV[0], begin_ns, scenario.initial_error, _biases(scenario), initial_rng,
        None if imu is not None else motion.angular_velocity_rad_s[0],
    )  # fmt: skip
    surroundings = Surroundings(descent.body, ground_heights(world.catalog))
    others = simulate_sensors(scenario.sensors, descent, surroundings, begin_ns, end_ns, sensor_rng)
    poses = descent.evaluate(_exposures_s(world)).gTb
    features = simulate_tracks(scenario.sensors, world.camera, stamps, poses, surroundings, sensor_rng)
    catalog = faults.perturb_map(world.catalog, scenario.faults, fault_rng)
    camera = faults.perturb_mounting(world.camera, scenario.faults, fault_rng)

    images = measured = None
    if scenario.render is not None:
        images = _images(world, frame_rng, progress)
    else:
        measured = tuple(_measurements(world, initial.gTb[:3, 3], (frame_rng, fault_rng), progress))
    recording = Recording(
        body=descent.body,
        camera=camera,
        catalog=catalog,
        imu=imu,
        imu_noise=None if scenario.imu is None else scenario.imu.noise(),
        initial=initial if with_initial else None,
        sun=world.sun,
        stamps_ns=stamps,
        truth=_truth(descent, imu, bias, stamps, others, initial),
        motion=None if scenario.motion is None else scenario.motion.motion(descent.body, Path()),
        measurements=measured,
        sensors=tuple(others),
        features=features,
    )
    return write_dataset(Path(folder), recording, images)


def _biases(scenario: Scenario) -> tuple[float, float]:
    """Return the standard deviations of the turn-on biases, or of what takes their place without an IMU."""
    if scenario.imu is not None:
        return scenario.imu.gyro_bias_rad_s, scenario.imu.accelerometer_bias_m_s2
    acceleration = getattr(scenario.motion, "acceleration_sigma_m_s2", UNUSED_SIGMA_M_S2)
    return math.radians(scenario.initial_error.angular_velocity_deg_s), acceleration


def _imu(world: World, rng: np.random.Generator) -> tuple[ImuLog | None, FloatArray]:
    """Simulate the IMU: its log, and the biases (n, 6) during each row's interval; none without an IMU."""
    options = world.scenario.imu
    if options is None:
        return None, np.empty((0, 6))
    stamps = sensors.imu_stamps(options, 0, int(world.stamps_ns[-1]))
    return sensors.corrupt_imu(sensors.ideal_imu(world.descent, stamps, 0), options, rng)


def _exposures_s(world: World) -> FloatArray:
    """Return the times (k,) at which the images are taken: their stamps plus the camera-IMU time offset."""
    return np.asarray(np.multiply(world.stamps_ns, 1e-9) + world.scenario.faults.time_offset_s)


def _images(world: World, rng: np.random.Generator, progress: Progress | None) -> Iterator[ImageArray]:
    """Render the images in their order, some while the ones before are exposed and written."""
    render = world.scenario.render
    assert render is not None
    renderer, times_s = world.renderer(), _exposures_s(world)
    half_s = 0.5 * render.exposure_s
    poses, begin, end = (world.descent.evaluate(times_s + side).gTb for side in (0.0, -half_s, half_s))
    suns = [world.sun.at(stamp) for stamp in world.stamps_ns.tolist()]

    def light(k: int) -> npt.NDArray[np.float32]:
        return renderer.light(poses[k], suns[k], (begin[k], end[k]) if half_s > 0.0 else None)

    with ThreadPoolExecutor(VIEWS_AT_ONCE) as beside:
        coming = deque(beside.submit(light, k) for k in range(min(VIEWS_AT_ONCE, len(suns))))
        for k, sun_g in enumerate(suns):
            here = coming.popleft().result()
            if k + VIEWS_AT_ONCE < len(suns):
                coming.append(beside.submit(light, k + VIEWS_AT_ONCE))
            yield renderer.expose(here, sun_g, rng)
            if progress is not None:
                progress(k + 1, len(suns))


def _measurements(
    world: World,
    prior_gP: FloatArray,
    rngs: tuple[np.random.Generator, np.random.Generator],
    progress: Progress | None,
) -> Iterator[FrameMeasurement]:
    """Simulate the measurements of the frames; random numbers of the measurements and of the faults."""
    options = world.scenario.measurements
    assert options is not None
    poses = world.descent.evaluate(_exposures_s(world)).gTb
    for k, stamp in enumerate(world.stamps_ns.tolist()):
        frame = sensors.measure(
            poses[k],
            stamp,
            world.sun.at(stamp),
            camera=world.camera,
            catalog=world.catalog,
            prior_gP=prior_gP,
            options=options,
            rng=rngs[0],
        )
        frame = faults.swap_matches(frame, world.catalog, world.scenario.faults, rngs[1])
        yield faults.without_craters(frame, world.scenario.faults)
        if progress is not None:
            progress(k + 1, len(world.stamps_ns))


def _truth(
    descent: Track,
    imu: ImuLog | None,
    bias: FloatArray,
    stamps: npt.NDArray[np.int64],
    others: Sequence[Sensor],
    initial: InitialState,
) -> Trajectory:
    """Truth at the frames and at the sensors' samples, which the posterior Cramér-Rao bound needs."""
    every = np.unique(np.concatenate([stamps, *(sensor.stamps_ns for sensor in others)]))
    motion = descent.evaluate(np.multiply(every, 1e-9))
    if imu is None:
        # What takes the gyro's bias refers to the prior's angular velocity.
        biases = np.zeros((len(every), 6))
        biases[:, :3] = np.array(initial.angular_velocity_rad_s) - motion.angular_velocity_rad_s
        return Trajectory(every, motion.gTb, motion.gV, biases)
    return Trajectory(every, motion.gTb, motion.gV, bias[np.searchsorted(imu.stamps_ns, every)])
