"""Elevation models of several resolutions: each continues where a finer one ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from craternav_fg.catalogs.dem import Dem, read_dem
from craternav_fg.errors import InputError
from factors.arrays import BoolArray, FloatArray

# Width over which a model gives way to the next coarser one: in steps of the latter, and at most as a share
# of the former's height.
_BLEND_STEPS, _BLEND_SHARE = 8.0, 0.05


@dataclass(frozen=True)
class NestedDem:
    """Elevation models of one body, the finest first.

    Along its border and its gaps a model gives way smoothly to the next, so that there is no cliff where they
    differ.

    Attributes
    ----------
    models : tuple of Dem
        One or more.
    """

    models: tuple[Dem, ...]

    @property
    def step_rad(self) -> float:
        """Distance of neighbouring rows of the finest model, as an angle."""
        return self.models[0].step_rad

    def heights_m(self, directions: FloatArray) -> FloatArray:
        """Interpolate heights.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors from the body's centre, in g.

        Returns
        -------
        ndarray, shape (n,)
            Heights above the sphere, m; beyond all models those of the last one's border, mirrored.
        """
        heights, left = np.zeros(len(directions)), np.ones(len(directions))
        # Places that finer models do not decide alone.
        rows = np.arange(len(directions))
        for finer, coarser in pairwise(self.models):
            height_rad = len(finer.coefficients) * finer.step_rad
            width_rad = min(_BLEND_STEPS * coarser.step_rad, _BLEND_SHARE * height_rad)
            weight = np.clip(finer.inside_rad(directions[rows]) / width_rad, 0.0, 1.0)
            weight *= weight * (3.0 - 2.0 * weight)
            inside = rows[weight > 0.0]
            heights[inside] += left[inside] * weight[weight > 0.0] * finer.heights_m(directions[inside])
            left[rows] *= 1.0 - weight
            rows = rows[weight < 1.0]
        heights[rows] += left[rows] * self.models[-1].heights_m(directions[rows])
        return heights

    def covers(self, directions: FloatArray) -> BoolArray:
        """Determine which places the models cover.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors from the body's centre, in g.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        return np.any([model.covers(directions) for model in self.models], axis=0)


def read_nested_dem(paths: Sequence[Path], unit_m: float = 1.0, radius_m: float | None = None) -> NestedDem:
    """Read elevation models of one body; coarser ones fill the gaps of the finer.

    Parameters
    ----------
    paths : sequence of Path
        See `read_dem`; the finest first.
    unit_m : float
        Unit of the values, m.
    radius_m : float, optional
        Radius of the body.

    Returns
    -------
    NestedDem

    Raises
    ------
    CraternavError
        When rasterio is not installed.
    InputError
        When a file is wrong, a model follows a coarser one, or a gap is in no coarser model.
    """
    models = [read_dem(path, unit_m, radius_m, gaps=path != paths[-1]) for path in paths]
    for k, (finer, coarser) in enumerate(pairwise(models)):
        if coarser.step_rad < finer.step_rad:
            raise InputError(paths[k + 1], f"is finer than {paths[k]}, expected the finest model first")
        gaps = finer.gaps()
        filled = np.any([model.covers(gaps) for model in models[k + 1 :]], axis=0)
        if not filled.all():
            holes = int(np.count_nonzero(~filled))
            raise InputError(paths[k], f"{holes} points have no height, in it and in the coarser models")
    return NestedDem(tuple(models))
