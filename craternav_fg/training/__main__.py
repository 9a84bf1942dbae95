"""Command that trains the judgement of candidates: python -m craternav_fg.training FOLDER [SCENES].

Examples of each scene are kept in the folder, so that a run which was stopped goes on. The weights are
written there, too, as judge.npz; shipped is what stands in `craternav_fg/vision`.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from os import cpu_count
from pathlib import Path

import numpy as np

from craternav_fg.files import replacing
from craternav_fg.training.examples import Examples, examples
from craternav_fg.training.network import train
from craternav_fg.training.scenes import scene
from craternav_fg.vision.judge import WEIGHTS, Network

# Seed of the shipped weights, which 100 scenes gave; scenes rendered by default.
SEED = 7
SCENES = 120


def collect(folder: Path, number: int) -> Path | None:
    """Render a scene, unless the folder has its examples.

    Parameters
    ----------
    folder : Path
    number : int
        Number of the scene, which determines it.

    Returns
    -------
    Path or None
        File of its examples; None when it gives none.
    """
    path = folder / f"{number:05d}.npz"
    if path.is_file():
        return path
    found = examples(scene(np.random.default_rng([SEED, number])))
    if found is None:
        return None
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, inputs=found.inputs.astype(np.float16), wanted=found.wanted)
    return path


def save(path: Path, network: Network) -> None:
    """Write a network as `vision.judge.network` reads it, in half precision."""
    layers = {f"weights{k}": values.astype(np.float16) for k, values in enumerate(network.weights)}
    layers |= {f"bias{k}": values.astype(np.float16) for k, values in enumerate(network.biases)}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **layers)


def main(folder: Path, count: int = SCENES) -> None:
    """Collect the examples of scenes and train on them.

    Parameters
    ----------
    folder : Path
    count : int
        Number of scenes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts: list[Examples] = []
    with ProcessPoolExecutor(cpu_count()) as workers:
        for number, path in enumerate(workers.map(partial(collect, folder), range(count))):
            if path is not None:
                with np.load(path) as stored:
                    parts.append(Examples(stored["inputs"].astype(np.float32), stored["wanted"]))
            sys.stderr.write(f"\rscene {number + 1} of {count}")
    inputs, wanted = (np.concatenate(values) for values in zip(*parts, strict=True))
    sys.stderr.write(f"\n{len(wanted)} examples, {wanted.mean():.0%} of craters\n")
    network = train(
        inputs, wanted, np.random.default_rng(SEED),
        progress=_report,
    )  # fmt: skip
    save(folder / WEIGHTS, network)


def _report(epoch: int, loss: float) -> None:
    sys.stderr.write(f"epoch {epoch}: loss {loss:.4f}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:3]))
