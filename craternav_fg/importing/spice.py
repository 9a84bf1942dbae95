"""States of a camera from SPICE kernels (NAIF): position, velocity, attitude, sun."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg import frames
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.files import SizeLimit, check_input, open_input
from craternav_fg.importing.assemble import CameraState
from factors.arrays import FloatArray

# What binary kernels begin with; SPICE reads all others as text.
_BINARY = (b"DAF/", b"DAS/", b"NAIF")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class SpiceQuery:
    """What is asked of the kernels.

    Attributes
    ----------
    kernels : tuple of Path
        Meta-kernels or kernels, loaded in this order.
    spacecraft : str
        Name or number.
    instrument_frame : str
        Frame of the camera, with axes x right, y down, z along the optical axis.
    target : str
        Body in the images.
    body_frame : str
        Frame g, fixed to that body.
    """

    kernels: tuple[Path, ...]
    spacecraft: str
    instrument_frame: str
    target: str
    body_frame: str


def camera_states(
    query: SpiceQuery, stamps_ns: Sequence[int]
) -> tuple[list[CameraState], tuple[float, float, float]]:
    """Compute the states of a camera, without aberration.

    Parameters
    ----------
    query : SpiceQuery
    stamps_ns : sequence of int
        UTC since 1970 without leap seconds, ns.

    Returns
    -------
    states : list of CameraState
    spin_rad_s : tuple of float
        Inertial angular velocity of g, in g, at the first stamp.

    Raises
    ------
    CraternavError
        When spiceypy is not installed.
    InputError
        When a kernel is missing, or the kernels do not cover a time or know a name.
    """
    with _loaded(query.kernels) as spice:
        epochs = []
        for stamp in stamps_ns:
            utc = _utc(stamp)
            epochs.append(_asked(spice, query, utc, lambda utc=utc: spice.str2et(utc)))
        states = [
            _asked(spice, query, _utc(stamp), lambda et=et: _state(spice, query, et))
            for stamp, et in zip(stamps_ns, epochs, strict=True)
        ]
        _, spin = _asked(
            spice, query, _utc(stamps_ns[0]), lambda: _rotation(spice, query.body_frame, epochs[0])
        )
    return states, (float(spin[0]), float(spin[1]), float(spin[2]))


@contextmanager
def _loaded(kernels: Sequence[Path]) -> Iterator[Any]:
    """Load kernels into a pool of their own, which is cleared in the end."""
    try:
        import spiceypy
    except ImportError:
        raise CraternavError("SPICE kernels need spiceypy: pip install 'craternav_fg[spice]'") from None
    try:
        for path in kernels:
            _check(path)
            try:
                spiceypy.furnsh(str(path))
            except spiceypy.utils.exceptions.SpiceyError as error:
                raise InputError(path, f"cannot be loaded: {_said(error)}") from None
        yield spiceypy
    finally:
        spiceypy.kclear()


def _check(path: Path) -> None:
    """Check that a kernel is a file, and no larger than SPICE reads in a few seconds."""
    with open_input(path, SizeLimit.KERNEL) as stream:
        is_binary = stream.read(len(_BINARY[0])) in _BINARY
    check_input(path, SizeLimit.KERNEL if is_binary else SizeLimit.TEXT_KERNEL)


def _asked(spice: Any, query: SpiceQuery, utc: str, ask: Any) -> Any:
    """Ask for something; what SPICE cannot answer is an error of one line."""
    try:
        return ask()
    except spice.utils.exceptions.SpiceyError as error:
        raise InputError(query.kernels[0], f"expected kernels that cover {utc}: {_said(error)}") from None


def _said(error: Any) -> str:
    """Return SPICE's short and long message in a line."""
    return " ".join(f"{error.short} {error.long}".split())


def _state(spice: Any, query: SpiceQuery, et: float) -> CameraState:
    km, _ = spice.spkezr(query.spacecraft, et, query.body_frame, "NONE", query.target)
    sun, _ = spice.spkpos("SUN", et, query.body_frame, "NONE", query.target)
    gRj, _ = _rotation(spice, query.body_frame, et)
    cRj, rate = _rotation(spice, query.instrument_frame, et)
    gTc = frames.pose(gRj @ cRj.T, 1e3 * np.asarray(km[:3]))
    return CameraState(gTc, 1e3 * np.asarray(km[3:]), rate, np.asarray(sun) / np.linalg.norm(sun))


def _rotation(spice: Any, frame: str, et: float) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) from J2000 to a frame, and its inertial angular velocity (3,) in the frame, rad/s."""
    try:
        rotation, rate = spice.xf2rav(spice.sxform("J2000", frame, et))
    except spice.utils.exceptions.SpiceyError:
        # A camera kernel without angular velocities still has the attitude.
        rotation, rate = spice.pxform("J2000", frame, et), np.zeros(3)
    return np.asarray(rotation), np.asarray(rotation) @ np.asarray(rate)


def _utc(stamp_ns: int) -> str:
    """Write a stamp as SPICE reads it, to the microsecond."""
    return (_EPOCH + timedelta(microseconds=stamp_ns / 1000)).strftime("%Y-%m-%dT%H:%M:%S.%f")
