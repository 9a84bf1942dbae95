"""Frames' rims that one call evaluates before GTSAM asks their factors.

A callback that reads its pose and calls a kernel takes twice as long as one that has its answer. A graph that
is linearised as a whole evaluates all frames first, and their factors then hand over what was written.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import accumulate
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray
from factors.errors import FactorError
from factors.kernels.packed import all_reduced_shape_residuals


class Ahead:
    """Frames whose rims are evaluated at once.

    Attributes
    ----------
    written : int
        What factors may take without a look at values: 0 nothing, 1 their residuals, 2 Jacobians as well.
    """

    def __init__(self) -> None:
        self.written = 0
        self._keys: list[int] = []
        self._data: list[FloatArray] = []
        self._views: list[list[FloatArray]] = []
        # Keys of the values last seen, and which of their poses the frames have.
        self._seen: list[int] = []
        self._rows = np.empty(0, dtype=np.int64)
        self._arrays: tuple[FloatArray, npt.NDArray[np.int64], FloatArray] | None = None

    def add(self, key: int, data: FloatArray) -> list[FloatArray]:
        """Add a frame.

        Parameters
        ----------
        key : int
            Key of the pose `gTb`.
        data : ndarray, shape (n_data,)
            Packed constants of two or more rims, see `packed.pack`.

        Returns
        -------
        list of ndarray
            Empty; where `written` says so, Jacobian (7, 6) and residual (7,), see
            `packed.reduced_shape_residuals`.
        """
        views: list[FloatArray] = []
        self._keys.append(key)
        self._data.append(data)
        self._views.append(views)
        self._arrays = None
        return views

    @contextmanager
    def at(self, values: gtsam.Values, *, linearise: bool) -> Iterator[None]:
        """Evaluate all frames; within the context only values with the same poses may be asked for.

        Parameters
        ----------
        values : gtsam.Values
            Poses in g, m. Where one of a frame is missing, nothing is evaluated.
        linearise : bool
            Whether Jacobians are written.

        Raises
        ------
        FactorError
            When something is not finite.
        """
        if not self._keys or not self._found(values):
            yield
            return
        data, offsets, out = self._arrays = self._arrays or self._joined()
        poses = np.ascontiguousarray(gtsam.utilities.extractPose3(values))
        bad = all_reduced_shape_residuals(poses, self._rows, data, offsets, linearise, out)
        if bad >= 0:
            where = gtsam.DefaultKeyFormatter(self._keys[bad])
            raise FactorError(f"factor at {where}: residual or Jacobian is not finite")
        self.written = 2 if linearise else 1
        try:
            yield
        finally:
            self.written = 0

    def _found(self, values: gtsam.Values) -> bool:
        """Look up the frames' poses; False where one is missing."""
        keys: list[Any] = list(values.keys())
        if keys != self._seen or len(self._rows) != len(self._keys):
            # Looking for poses among all values takes as long as a rim for each of them.
            places = {key: place for place, key in enumerate(gtsam.utilities.allPose3s(values).keys())}
            rows = [places.get(key, -1) for key in self._keys]
            if min(rows) < 0:
                return False
            self._seen, self._rows = keys, np.array(rows, dtype=np.int64)
        return True

    def _joined(self) -> tuple[FloatArray, npt.NDArray[np.int64], FloatArray]:
        """Arrays for the kernel; the frames' views of what it writes are set."""
        out = np.zeros((len(self._keys), 7, 7))
        for views, of_frame in zip(self._views, out, strict=True):
            # Column-major, as GTSAM's own matrices are: copied without a stride.
            views[:] = [of_frame[:6].T, of_frame[6]]
        offsets = np.array(list(accumulate(map(len, self._data), initial=0)), dtype=np.int64)
        return np.concatenate(self._data), offsets, out
