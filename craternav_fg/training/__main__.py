"""Command that trains the crater network on rendered ground: python -m craternav_fg.training craters FOLDER.

It keeps what is done in the folder, and goes on there when it is started again.
"""

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path

from craternav_fg.errors import CraternavError

# Steps of the shipped weights.
STEPS = 3900


def main(arguments: list[str]) -> int:
    """Train a network.

    Parameters
    ----------
    arguments : list of str
        Of the command line.

    Returns
    -------
    int
        Exit code: 2 for what cannot be done.
    """
    parser = argparse.ArgumentParser(prog="python -m craternav_fg.training", description=__doc__)
    commands = parser.add_subparsers(dest="network", required=True)
    craters = commands.add_parser("craters", help="crater network: craters.onnx; needs the extra train")
    craters.add_argument("--steps", type=int, default=STEPS)
    craters.add_argument("--seed", type=int, default=7)
    craters.add_argument("folder", type=Path)
    given = parser.parse_args(arguments)
    if find_spec("torch") is None:
        sys.stderr.write("training: PyTorch is missing: pip install 'craternav_fg[train]'\n")
        return 2
    try:
        _train_craters(given.folder, given.steps, given.seed)
    except CraternavError as error:
        sys.stderr.write(f"training: {error}\n")
        return 2
    return 0


def _train_craters(folder: Path, steps: int, seed: int) -> None:
    from craternav_fg.training.detector import export
    from craternav_fg.training.loop import TrainingOptions, train

    folder.mkdir(parents=True, exist_ok=True)
    network = train(folder, TrainingOptions(steps=steps, seed=seed), _report)
    export(network, folder / "craters.onnx")


def _report(step: int, centre: float, circle: float) -> None:
    sys.stderr.write(f"step {step}: loss of centres {centre:.3f}, of circles {circle:.3f}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
