"""Simulated logs of the sensors beside camera and IMU."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from craternav_fg.camera import Camera
from craternav_fg.sensors.point_features import NAME as FEATURES
from craternav_fg.sensors.point_features import FeatureTracks, simulate_features
from craternav_fg.sensors.protocol import Sensor, SensorState, Surroundings
from craternav_fg.simulation.sensor_tables import feature_plan, sensor_plan
from craternav_fg.simulation.trajectory import Track
from factors.arrays import FloatArray, IntArray


def simulate_sensors(
    tables: Mapping[str, Mapping[str, Any]],
    descent: Track,
    surroundings: Surroundings,
    begin_ns: int,
    end_ns: int,
    rng: np.random.Generator,
) -> list[Sensor]:
    """Draw the logs of a scenario's sensors.

    Parameters
    ----------
    tables : mapping
        `[sensors]` of the scenario.
    descent : Track
    surroundings : Surroundings
        The true ones.
    begin_ns, end_ns : int
        Begin and end of the log.
    rng : numpy.random.Generator

    Returns
    -------
    list of Sensor
        Those that have a sample.
    """
    out = []
    for name, table in tables.items():
        if name == FEATURES:
            continue
        kind, settings, plan = sensor_plan(name, table)
        step = round(1e9 / settings.rate_hz)
        stamps = np.arange(begin_ns, end_ns + 1, step, dtype=np.int64)
        motion = descent.evaluate(np.multiply(stamps, 1e-9))
        altitude_m = descent.body.altitude_m(motion.gP)
        on = (altitude_m >= plan.above_m) & (altitude_m <= (np.inf if plan.below_m is None else plan.below_m))
        states = [
            SensorState(int(stamps[k]), motion.gTb[k], motion.gV[k], motion.angular_velocity_rad_s[k])
            for k in np.flatnonzero(on)
        ]
        (stream,) = rng.spawn(1)
        sensor = kind.simulate(settings, states, surroundings, stream, plan.outlier_share)
        sound = np.isfinite(sensor.values).all(axis=1)
        if sound.any():
            out.append(kind(settings, sensor.stamps_ns[sound], sensor.values[sound], surroundings))
    return out


def simulate_tracks(
    tables: Mapping[str, Mapping[str, Any]],
    camera: Camera,
    stamps_ns: IntArray,
    gTb: FloatArray,
    surroundings: Surroundings,
    rng: np.random.Generator,
) -> FeatureTracks | None:
    """Draw the tracks of `[sensors.features]`; None without that table.

    Parameters
    ----------
    tables : mapping
        `[sensors]` of the scenario.
    camera : Camera
    stamps_ns : ndarray of int, shape (k,)
        Stamps of the frames, ns.
    gTb : ndarray, shape (k, 4, 4)
        True poses of the body in g, m.
    surroundings : Surroundings
        The true ones.
    rng : numpy.random.Generator

    Returns
    -------
    FeatureTracks or None
    """
    if FEATURES not in tables:
        return None
    settings, plan = feature_plan(tables[FEATURES])
    poses = list(zip(stamps_ns.tolist(), gTb, strict=True))
    return simulate_features(settings, plan, camera, poses, surroundings, rng.spawn(1)[0])
