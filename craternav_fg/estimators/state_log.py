"""A filter's states at successive frames: the newest ones in memory, older ones in a temporary file."""

import io
import tempfile
import weakref
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from craternav_fg.estimators.filter_state import BIAS, POSE, FilterState
from craternav_fg.trajectory import Trajectory
from factors.kernels.strapdown import SIZE, VELOCITY

# Number of states that are written together; a shorter log needs no file.
_BLOCK = 512


class StateLog:
    """Stamps and states in the order in which they are appended; memory does not grow with their number.

    Parameters
    ----------
    sensor_biases : int
        Number b of biases of sensors in each state.
    """

    def __init__(self, sensor_biases: int = 0) -> None:
        size = SIZE + sensor_biases
        self._type = np.dtype(
            [
                ("stamp_ns", np.int64),
                ("gTb", np.float64, (4, 4)),
                ("gV", np.float64, (3,)),
                ("rate", np.float64, (3,)),
                ("bias", np.float64, (6,)),
                ("covariance", np.float64, (size, size)),
                ("sensor_bias", np.float64, (sensor_biases,)),
            ]
        )
        self._rows = np.empty(_BLOCK, self._type)
        self._written = 0
        self._count = 0
        self._file: BinaryIO | None = None

    def __len__(self) -> int:
        return self._written + self._count

    def append(self, stamp_ns: int, state: FilterState) -> None:
        """Append a state.

        Parameters
        ----------
        stamp_ns : int
        state : FilterState
        """
        if self._count == _BLOCK:
            self._write()
        values = [getattr(state, name) for name in self._type.names[1:]]  # type: ignore[index]
        self._rows[self._count] = (stamp_ns, *values)
        self._count += 1

    def states(self) -> list[FilterState]:
        """Read all states.

        Returns
        -------
        list of FilterState
        """
        names = self._type.names[1:]  # type: ignore[index]
        return [
            FilterState(**{name: row[name].copy() for name in names})
            for block in self._blocks()
            for row in block
        ]

    def trajectory(self) -> Trajectory:
        """Gather all states as a trajectory.

        Returns
        -------
        Trajectory
        """
        stamps = np.empty(len(self), np.int64)
        gTb, gV, bias = np.empty((len(self), 4, 4)), np.empty((len(self), 3)), np.empty((len(self), 6))
        P, velocity = np.empty((len(self), 6, 6)), np.empty((len(self), 3, 3))
        biases = np.empty_like(P)
        first = 0
        for block in self._blocks():
            rows = slice(first, first + len(block))
            first = rows.stop
            stamps[rows], gTb[rows], gV[rows], bias[rows] = (
                block[name] for name in ("stamp_ns", "gTb", "gV", "bias")
            )
            covariance = block["covariance"]
            P[rows] = covariance[:, POSE, POSE]
            velocity[rows], biases[rows] = covariance[:, VELOCITY, VELOCITY], covariance[:, BIAS, BIAS]
        return Trajectory(
            stamps_ns=stamps, gTb=gTb, gV=gV, bias=bias, pose_covariance=P, velocity_covariance=velocity,
            bias_covariance=biases,
        )  # fmt: skip

    def _write(self) -> None:
        """Move the rows in memory to the file."""
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix="craternav-", buffering=0)  # noqa: SIM115
            weakref.finalize(self, self._file.close)
        self._file.seek(0, io.SEEK_END)
        self._rows[: self._count].tofile(self._file)
        self._written += self._count
        self._count = 0

    def _blocks(self) -> Iterator[npt.NDArray[np.void]]:
        """Return the rows, some at a time."""
        for first in range(0, self._written, _BLOCK):
            assert self._file is not None
            self._file.seek(first * self._type.itemsize)
            yield np.fromfile(self._file, self._type, _BLOCK)
        if self._count:
            yield self._rows[: self._count]
