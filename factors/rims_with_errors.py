"""Rims of many frames with errors that are variables, linearised in one call.

A factor written in Python costs a callback, and a descent has a factor for each rim with errors of its own.
Here one compiled call evaluates all of them, and GTSAM gets what it is to eliminate.
"""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from factors.arrays import FloatArray
from factors.conic_shape import ChartError, pack_with_errors
from factors.custom import Loss
from factors.errors import FactorError
from factors.kernels.rim_errors import all_shape_residuals_with_errors

_UNIT = gtsam.noiseModel.Unit.Create(5)
# Errors of a rim beside which `gtsam.JacobianFactor` has a constructor.
_MOST_ERRORS = 2


class RimsWithErrors:
    """The same as the factors of `conic_shape.conic_shape_factors`, of any number of frames."""

    def __init__(self) -> None:
        # By the lengths of a rim's errors, which are the same for most rims.
        self._kinds: dict[tuple[int, ...], _Kind] = {}

    @property
    def rows(self) -> int:
        """Number of whitened rows of all rims."""
        return sum(5 * len(kind) for kind in self._kinds.values())

    def add(
        self,
        key: int,
        bTc: npt.ArrayLike,
        centres: npt.ArrayLike,
        axes: npt.ArrayLike,
        charts: npt.ArrayLike,
        covariances: npt.ArrayLike,
        errors: Sequence[ChartError],
        loss: Loss = Loss(),
    ) -> None:
        """Add the rims of a frame.

        Parameters
        ----------
        key : int
            Key of the pose `gTb`.
        bTc, centres, axes : array_like, shapes (4, 4), (n, 3), (n, 2, 3)
            Lengths in m, as for `conic_shape_factors`.
        charts, covariances : array_like, shapes (n, 5), (n, 5, 5)
            In normalised coordinates; without the errors.
        errors : sequence of ChartError
            Errors of the charts, to be estimated.
        loss : Loss
            Applied to each crater's 5-dimensional norm.

        Raises
        ------
        FactorError
            Naming the field that is not finite, mis-shaped, or not positive definite.
        """
        data = pack_with_errors(bTc, centres, axes, charts, covariances, errors, loss)
        lengths = tuple(error.roots.shape[2] for error in errors)
        kind = self._kinds.setdefault(lengths, _Kind(lengths))
        kind.add(key, data, list(zip(*(error.keys for error in errors), strict=True)))

    def error(self, values: gtsam.Values) -> float:
        """Half the sum of squares of all residuals, under their loss.

        Parameters
        ----------
        values : gtsam.Values
            Poses in g, m; errors in the units of their roots.

        Returns
        -------
        float

        Raises
        ------
        FactorError
            When something is not finite.
        """
        return sum(kind.evaluate(values, linearise=False) for kind in self._kinds.values())

    def linearise(self, values: gtsam.Values, linear: gtsam.GaussianFactorGraph) -> None:
        """Add the linear factors of all rims to a graph.

        Parameters
        ----------
        values : gtsam.Values
            Poses in g, m; errors in the units of their roots.
        linear : gtsam.GaussianFactorGraph

        Raises
        ------
        FactorError
            When something is not finite.
        """
        for kind in self._kinds.values():
            kind.linearise(values, linear)


class _Kind:
    """Rims whose errors have the same lengths."""

    def __init__(self, lengths: tuple[int, ...]) -> None:
        self._lengths = lengths
        self._poses: dict[int, int] = {}
        # Of each error, its place among all of them.
        self._errors: dict[int, int] = {}
        self._size = 0
        self._of_pose: list[int] = []
        self._places: list[list[int]] = []
        self._keys: list[tuple[int, ...]] = []
        self._data: list[FloatArray] = []
        self._arrays: tuple[Any, ...] = ()

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, key: int, data: FloatArray, errors: Sequence[tuple[int, ...]]) -> None:
        """Add the rims of a frame: what is packed of them, and the keys of their errors."""
        pose = self._poses.setdefault(key, len(self._poses))
        for keys in errors:
            for error, length in zip(keys, self._lengths, strict=True):
                if error not in self._errors:
                    self._errors[error] = self._size
                    self._size += length
            self._places.append([self._errors[error] for error in keys])
            self._of_pose.append(pose)
            self._keys.append((key, *keys))
        self._data.append(data)
        self._arrays = ()

    def evaluate(self, values: gtsam.Values, *, linearise: bool) -> float:
        """Write residuals, and Jacobians where they are asked for; return the error."""
        if not self._arrays:
            self._arrays = self._joined()
        poses, of_pose, errors, places, data, out, _ = self._arrays
        for key, number in self._poses.items():
            poses[number] = values.atPose3(key).matrix().T
        for key, begin in self._errors.items():
            z = values.atVector(key)
            errors[begin : begin + len(z)] = z
        error, bad = all_shape_residuals_with_errors(poses, of_pose, errors, places, data, linearise, out)
        if bad >= 0:
            where = gtsam.DefaultKeyFormatter(self._keys[bad][0])
            raise FactorError(f"factor at {where}: residual or Jacobian is not finite")
        return float(error)

    def linearise(self, values: gtsam.Values, linear: gtsam.GaussianFactorGraph) -> None:
        self.evaluate(values, linearise=True)
        out, terms = self._arrays[-2:]
        for blocks, b in zip(terms, -out[:, 6], strict=True):
            if len(self._lengths) <= _MOST_ERRORS:
                fields: list[Any] = [*blocks, b, _UNIT]
                linear.push_back(gtsam.JacobianFactor(*fields))
            else:
                # The only constructor that takes any number of variables.
                pairs: list[Any] = list(zip(blocks[::2], blocks[1::2], strict=True))
                linear.push_back(gtsam.JacobianFactor(gtsam.GaussianConditional(pairs, len(pairs), b, _UNIT)))

    def _joined(self) -> tuple[Any, ...]:
        """Arrays for the kernel, and the keys and Jacobians of each rim: views of what it writes."""
        n = len(self)
        out = np.zeros((n, 7 + sum(self._lengths), 5))
        ends = np.cumsum([7, *self._lengths]).tolist()
        terms = []
        for keys, columns in zip(self._keys, out, strict=True):
            blocks: list[Any] = [keys[0], columns[:6].T]
            for key, begin, end in zip(keys[1:], ends[:-1], ends[1:], strict=True):
                blocks += [key, columns[begin:end].T]
            terms.append(blocks)
        return (
            np.empty((len(self._poses), 4, 4)),
            np.array(self._of_pose, dtype=np.int64),
            np.zeros(self._size),
            np.concatenate(
                [
                    begins[:, None] + np.arange(length)
                    for begins, length in zip(np.array(self._places).T, self._lengths, strict=True)
                ],
                axis=1,
            ),
            np.concatenate(self._data),
            out,
            terms,
        )
