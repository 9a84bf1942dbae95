"""A data set of imported images: frames in the order of time, a motion model, states that come along."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset import Recording, SunVectors, write_dataset
from craternav_fg.dataset.apriori import AprioriStates
from craternav_fg.dataset.images import ImageArray
from craternav_fg.errors import InputError
from craternav_fg.importing.leap_seconds import leap_second_between
from craternav_fg.motion.coast import coast
from craternav_fg.motion.model import Motion
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class CameraState:
    """State of a camera at an image, as SPICE or an ISIS cube gives it.

    Attributes
    ----------
    gTc : ndarray, shape (4, 4)
        Pose of the camera in g, m.
    gV : ndarray, shape (3,)
        Velocity relative to g, in g, m/s.
    rate_rad_s : ndarray, shape (3,)
        Inertial angular velocity in c, rad/s.
    sun : ndarray, shape (3,)
        Unit vector towards the sun in g.
    """

    gTc: FloatArray
    gV: FloatArray
    rate_rad_s: FloatArray
    sun: FloatArray


@dataclass(frozen=True)
class ImportedFrame:
    """An image and when it was taken.

    Attributes
    ----------
    path : Path
        Where it comes from: its stem names the image in the data set.
    stamp_ns : int
    state : CameraState or None
        None when nobody states it.
    """

    path: Path
    stamp_ns: int
    state: CameraState | None = None


@dataclass(frozen=True)
class Imported:
    """What a data set is made of, beside its images.

    Attributes
    ----------
    frames : sequence of ImportedFrame
        In any order.
    camera : Camera
    body : Body
        With gravity and spin.
    catalog : Catalog
    motion : Motion
    position_sigma_m, attitude_sigma_rad : float
        Stated standard deviations per axis of the frames' states.
    sun : ndarray, shape (3,), or None
        Direction towards the sun in g at the first frame, where the frames' states do not give it.
    """

    frames: Sequence[ImportedFrame]
    camera: Camera
    body: Body
    catalog: Catalog
    motion: Motion
    position_sigma_m: float = 1000.0
    attitude_sigma_rad: float = math.radians(0.1)
    sun: FloatArray | None = None


def in_order(frames: Sequence[ImportedFrame]) -> list[ImportedFrame]:
    """Sort frames by time.

    Parameters
    ----------
    frames : sequence of ImportedFrame

    Returns
    -------
    list of ImportedFrame

    Raises
    ------
    InputError
        When there is none, two are of one time, two have one name, or there is a leap second between them.
    """
    if not frames:
        raise InputError("images", "expected at least one, found none")
    ordered = sorted(frames, key=lambda frame: frame.stamp_ns)
    for one, other in itertools.pairwise(ordered):
        if one.stamp_ns == other.stamp_ns:
            raise InputError(other.path, f"expected each time once, {one.path} has the same")
        if (day := leap_second_between(one.stamp_ns, other.stamp_ns)) is not None:
            problem = f"the leap second at the end of {day} is between this image and {one.path}"
            raise InputError(
                other.path, f"{problem}: stamps do not count it; import the images before and after it apart"
            )
    names = [frame.path.stem for frame in ordered]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError(
                ordered[k].path, f"expected each name once, {ordered[names.index(name)].path} has the same"
            )
    return ordered


def write_imported(folder: Path, given: Imported, images: Iterable[ImageArray]) -> Path:
    """Write a data set of imported images.

    Parameters
    ----------
    folder : Path
        Replaced when it is empty or a data set.
    given : Imported
    images : iterable of ndarray of uint8 or uint16, shape (height, width)
        Grey levels, in the order of `in_order`.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        When the frames contradict each other, no sun is known, the folder cannot be written, or
        `Dataset.open` would refuse the data set, which is not kept then.
    """
    frames = in_order(given.frames)
    stamps = np.array([frame.stamp_ns for frame in frames], dtype=np.int64)
    catalog = replace(given.catalog, body=given.body)
    states = states_at(frames, given.body)
    # The states are those of the camera, which is b then.
    camera = given.camera if states is None else replace(given.camera, bTc=np.eye(4))
    recording = Recording(
        body=given.body,
        camera=camera,
        catalog=catalog,
        imu=None,
        imu_noise=None,
        initial=None,
        sun=_sun(frames, stamps, given),
        stamps_ns=stamps,
        motion=given.motion,
        apriori=None
        if states is None
        else AprioriStates(states, given.position_sigma_m, given.attitude_sigma_rad),
    )
    names = [f"{frame.path.stem}.png" for frame in frames]
    return write_dataset(folder, recording, images, names, verified=True)


def states_at(frames: Sequence[ImportedFrame], body: Body) -> Trajectory | None:
    """States at all frames: stated ones, else the nearest stated one in free fall.

    Parameters
    ----------
    frames : sequence of ImportedFrame
        In the order of time.
    body : Body

    Returns
    -------
    Trajectory or None
        Trajectory of the camera; None when no frame has a state.
    """
    known = [k for k, frame in enumerate(frames) if frame.state is not None]
    if not known:
        return None
    fall = coast()
    gTb, gV, bias = np.empty((len(frames), 4, 4)), np.empty((len(frames), 3)), np.zeros((len(frames), 6))
    for k, frame in enumerate(frames):
        nearest = min(known, key=lambda j: abs(frames[j].stamp_ns - frame.stamp_ns))
        state = frames[nearest].state
        assert state is not None
        bias[k, :3] = -state.rate_rad_s
        gTb[k], gV[k] = state.gTc, state.gV
        if nearest != k:
            seconds = 1e-9 * (frame.stamp_ns - frames[nearest].stamp_ns)
            gTb[k], gV[k], _, _ = fall.free(body, (gTb[k], gV[k], bias[k]), seconds)
    stamps = np.array([frame.stamp_ns for frame in frames], dtype=np.int64)
    return Trajectory(stamps, gTb, gV, bias)


def _sun(frames: Sequence[ImportedFrame], stamps: IntArray, given: Imported) -> SunVectors:
    """Directions towards the sun: from the nearest states, else the given one, as the body turns."""
    spin = given.body.spin_rad_s
    known = [k for k, frame in enumerate(frames) if frame.state is not None]
    if not known:
        if given.sun is None:
            raise InputError(frames[0].path, "expected the direction towards the sun, found none")
        return SunVectors.among_stars(given.sun, int(stamps[0]), stamps, spin)
    vectors = []
    for k, stamp in enumerate(stamps):
        nearest = min(known, key=lambda j: abs(int(stamps[j] - stamp)))
        state = frames[nearest].state
        assert state is not None
        then = int(stamps[nearest])
        vectors.append(SunVectors.among_stars(state.sun, then, stamps[k : k + 1], spin).vectors[0])
    return SunVectors(stamps, np.array(vectors))
