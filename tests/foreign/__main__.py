"""Table of the front end's errors and the smoothers' by world: python -m tests.foreign [KIND...]."""

import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

from craternav_fg.dataset import Dataset
from craternav_fg.pipeline.reconstruct import reconstruct
from tests.foreign.files import write
from tests.foreign.rim_errors import RimErrors, errors_of_frame
from tests.foreign.worlds import KINDS, World, draw_world

ESTIMATORS = ("smoother", "centre_smoother", "online", "ekf")
say = Console(width=200, highlight=False, markup=False).print
_COLUMNS = ("rims", "centre_px", "size_bias_percent", "size_px", "shape_px", "chi2")


def main(kinds: list[str], seeds: int = 1) -> None:
    """Print a line for each kind of ground, family of craters and wear, and one for each descent."""
    say(f"{'':28}" + "".join(f"{name:>19}" for name in _COLUMNS))
    for kind in kinds or KINDS:
        for seed in range(1, seeds + 1):
            world = draw_world(seed, kind)
            with tempfile.TemporaryDirectory() as folder:
                data = Dataset.open(write(world, Path(folder) / "data", seed))
                result = reconstruct(data, ESTIMATORS)
            errors = RimErrors.joined(
                [errors_of_frame(world, k, frame.rims) for k, frame in enumerate(result.frames)]
            )
            _print_rims(f"{kind} {seed}", world, errors)
            assert data.truth is not None
            off = {
                name: np.linalg.norm(one.gTb[:, :3, 3] - data.truth.gTb[:, :3, 3], axis=1)
                for name, one in result.trajectories.items()
            }
            nees = {}
            for name, one in result.trajectories.items():
                turn = np.einsum("kji,kjl->kil", data.truth.gTb[:, :3, :3], one.gTb[:, :3, :3])
                small = 0.5 * np.stack(
                    [
                        turn[:, 2, 1] - turn[:, 1, 2],
                        turn[:, 0, 2] - turn[:, 2, 0],
                        turn[:, 1, 0] - turn[:, 0, 1],
                    ],
                    axis=-1,
                )
                e = np.concatenate([small, one.gTb[:, :3, 3] - data.truth.gTb[:, :3, 3]], axis=1)
                P = one.pose_covariance
                assert P is not None
                nees[name] = float(
                    np.mean(np.einsum("ki,ki->k", e, np.linalg.solve(P, e[..., None])[..., 0]))
                )
            say(
                "    position RMS m, ANEES: "
                + ", ".join(f"{n} {np.sqrt(np.mean(v**2)):.2f} {nees[n]:.1f}" for n, v in off.items())
            )
            for text in result.warnings:
                say(f"    {text}")


def _print_rims(title: str, world: World, errors: RimErrors) -> None:
    craters = world.ground.craters
    families, wear = np.array(craters.family)[errors.crater], craters.wear[errors.crater]
    parts = {title: np.ones(len(wear), dtype=np.bool_)}
    parts |= {f"  {family}": families == family for family in sorted(set(families.tolist()))}
    parts |= {"  fresh": wear < 0.33, "  worn": wear >= 0.33}
    for name, rows in parts.items():
        if rows.sum() > 1:
            values = errors.take(rows).summary()
            say(f"{name:28}" + "".join(f"{values[column]:19.3f}" for column in _COLUMNS))


if __name__ == "__main__":
    main(sys.argv[1:])
