"""Systematic errors of the sun's tilt, as craters' walls and as relief without craters show it.

Seen obliquely, the tilt depends on the ground's law of reflection, which is not known: the rendered ground
reflects by any mixture of Lommel-Seeliger and Lambert. The squares of the floors are the mean squares of the
errors, less what the scatter of craters or blocks explains: looking straight down, then obliquely.
"""

from dataclasses import replace

import numpy as np

from craternav_fg.calibration.regenerated import Regenerated
from craternav_fg.catalogs.model import Catalog
from craternav_fg.simulation.scenes import Ground, Scene, scene
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.sun import SunOptions, measure_sun_tilt
from factors.arrays import FloatArray
from factors.kernels.sun import sun_tilt as true_tilt
from factors.kernels.sun import wrap

# First seed and number of the scenes (tests use other seeds), and their angles off nadir.
_FIRST_SEED, _SCENES = 7000, 30
_NADIR_DEG, _OBLIQUE_DEG = (0.0, 0.0), (20.0, 40.0)
# Without floors; then with one of 1 rad each, which tells the scale of both.
_BARE = replace(
    SunOptions(), floor_rad=0.0, floor_oblique_rad=0.0, crater_floor_rad=0.0, crater_floor_oblique_rad=0.0,
    max_sigma_rad=1e3,
)  # fmt: skip
_OPTIONS = (
    _BARE,
    replace(_BARE, floor_rad=1.0, crater_floor_rad=1.0),
    replace(_BARE, floor_oblique_rad=1.0, crater_floor_oblique_rad=1.0),
)


def sun_tilt() -> list[Regenerated]:
    """Regenerate the floors of `SunOptions`.

    Returns
    -------
    list of Regenerated
    """
    shipped = SunOptions()
    down, aside = (
        [_scene(seed, tilt_deg) for seed in range(_FIRST_SEED, _FIRST_SEED + _SCENES)]
        for tilt_deg in (_NADIR_DEG, _OBLIQUE_DEG)
    )
    floors = {
        "crater_floor": (shipped.crater_floor_rad, shipped.crater_floor_oblique_rad),
        "floor": (shipped.floor_rad, shipped.floor_oblique_rad),
    }
    out = []
    for name, (level_rad, oblique_rad) in floors.items():
        with_craters = name == "crater_floor"
        error, bare2, level, _ = _errors(down, with_craters)
        out.append(_square(f"SunOptions.{name}_rad", level_rad, error**2 - bare2, level))
        error, bare2, level, oblique = _errors(aside, with_craters)
        rest = error**2 - bare2 - np.degrees(level_rad) ** 2 * level
        out.append(_square(f"SunOptions.{name}_oblique_rad", oblique_rad, rest, oblique))
    return out


def _scene(seed: int, tilt_deg: tuple[float, float]) -> Scene:
    law = float(np.random.default_rng(seed).uniform())
    return scene(seed, Ground(tilt_deg=tilt_deg, lunar_lambert=law))


def _square(name: str, shipped_rad: float, variance: FloatArray, scale: FloatArray) -> Regenerated:
    """Fit a floor's square, deg^2, by which variances (n,) are `scale` (n,) times it."""
    square = float(variance.sum() / scale.sum())
    error = float(np.sqrt(np.sum((variance - square * scale) ** 2)) / scale.sum())
    return Regenerated(f"{name} squared, deg2", float(np.degrees(shipped_rad) ** 2), square, error)


def _whole_craters(one: Scene) -> Catalog:
    least = GuidedOptions()
    rows, _ = one.catalog.visible(
        one.camera, one.gTb, min_semi_minor_px=least.min_semi_minor_px, margin_px=least.margin_px
    )
    return one.catalog.take(rows)


def _errors(scenes: list[Scene], with_craters: bool) -> FloatArray:
    """Errors of tilts, deg, variances without floors, deg^2, and those of each floor of 1: rows (4, n)."""
    rows = []
    for one in scenes:
        craters = _whole_craters(one) if with_craters else None
        tilts = [
            measure_sun_tilt(one.image, one.camera, one.catalog.body, one.gTb, one.sun_g, o, 0.0, craters)
            for o in _OPTIONS
        ]
        known = [tilt for tilt in tilts if tilt is not None]
        if len(known) < len(tilts):
            continue
        bare, level, oblique = (tilt.sigma_rad**2 for tilt in known)
        u, v = known[0].point
        true, _ = true_tilt(one.gTb, one.camera.bTc, known[0].direction, u, v, np.empty((1, 6)))
        error = np.degrees(wrap(known[0].tilt_rad - true))
        rows.append([error, np.degrees(np.degrees(bare)), level - bare, oblique - bare])
    return np.array(rows).T
