"""Training of the crater network with PyTorch (extra `train`), on rendered ground alone.

A step's images are determined by its number and the seed, so that a run which was stopped goes on from its
last checkpoint as if it had not been.
"""

import pickle
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from craternav_fg.errors import InputError
from craternav_fg.files import replacing
from craternav_fg.training.detector import CraterNetwork
from craternav_fg.training.tiles import TileMaker, Tiles

CHECKPOINT = "checkpoint.pt"
# Weight of the circle in the loss, decay of the average of the weights, and steps between checkpoints.
_CIRCLE_WEIGHT, _AVERAGE, _CHECKPOINT_EVERY = 1.0, 0.995, 25
# Steps in which the rate of learning rises, and share of them in which it falls to zero at the end.
_RISING, _FALLING_SHARE = 100, 0.35
_LARGEST_GRADIENT = 5.0


@dataclass(frozen=True)
class TrainingOptions:
    """How the network is trained.

    Attributes
    ----------
    steps : int
        The rate of learning falls in the last third of them: until there a run may be given more or fewer.
    rate : float
        Largest rate of learning.
    weight_decay : float
    seed : int
    """

    steps: int = 3900
    rate: float = 3e-3
    weight_decay: float = 1e-3
    seed: int = 7


def train(
    folder: Path, options: TrainingOptions, progress: Callable[[int, float, float], None] | None = None
) -> CraterNetwork:
    """Train a network, from the folder's checkpoint if it has one.

    Parameters
    ----------
    folder : Path
        Keeps the checkpoint.
    options : TrainingOptions
    progress : callable, optional
        Called with the number of steps done and the mean losses of centres and circles since the last call.

    Returns
    -------
    CraterNetwork
        With the average of the last weights.

    Raises
    ------
    InputError
        When the checkpoint cannot be read, or is of another network, seed or rate.
    """
    torch.manual_seed(options.seed)
    network = CraterNetwork().to(memory_format=torch.channels_last)
    average = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(_AVERAGE), use_buffers=True)
    adam = torch.optim.AdamW(network.parameters(), lr=options.rate, weight_decay=options.weight_decay)
    kept = {"network": network, "average": average, "adam": adam}
    first = _restored(folder / CHECKPOINT, kept, options)
    maker, losses = TileMaker(options.seed), []
    network.train()
    for step in range(first, options.steps):
        for group in adam.param_groups:
            group["lr"] = options.rate * _rate(step, options.steps)
        made = _batch(maker.tiles(step))
        with torch.autocast("cpu", torch.bfloat16):
            seen = network(made.inputs)
        centre, circle = _losses(seen.float(), made)
        adam.zero_grad()
        (centre + _CIRCLE_WEIGHT * circle).backward()
        nn.utils.clip_grad_norm_(network.parameters(), _LARGEST_GRADIENT)
        adam.step()
        average.update_parameters(network)
        losses.append((float(centre.detach()), float(circle.detach())))
        if (step + 1) % _CHECKPOINT_EVERY == 0 or step + 1 == options.steps:
            _keep(folder / CHECKPOINT, step + 1, kept, options)
            if progress is not None:
                progress(step + 1, *map(float, np.mean(losses, axis=0)))
            losses.clear()
    best: CraterNetwork = average.module
    return best


def _restored(path: Path, kept: dict[str, Any], options: TrainingOptions) -> int:
    """Load a checkpoint, and return its number of steps: 0 if there is none."""
    if not path.is_file():
        return 0
    try:
        stored = torch.load(path)
    except (pickle.UnpicklingError, RuntimeError, EOFError) as error:
        raise InputError(path, "cannot be read as a checkpoint") from error
    try:
        steps, given = int(stored["steps"]), dict(stored["options"])
        states = {name: stored[name] for name in kept}
    except (LookupError, TypeError, ValueError) as error:
        found = ", ".join(map(str, stored)) if isinstance(stored, dict) else type(stored).__name__
        names = ", ".join(("steps", "options", *kept))
        raise InputError(path, f"expected {names}, found {shorten(found, 80)}") from error
    for name in ("seed", "rate", "weight_decay"):
        if given.get(name) != getattr(options, name):
            raise InputError(path, f"expected {name} {getattr(options, name)}, found {given.get(name)}")
    for name, part in kept.items():
        try:
            part.load_state_dict(states[name])
        except (LookupError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise InputError(path, f"expected the {name} of this training, found another one") from error
    return steps


def _keep(path: Path, steps: int, kept: dict[str, Any], options: TrainingOptions) -> None:
    states = {name: part.state_dict() for name, part in kept.items()}
    with replacing(path) as temporary:
        torch.save({"steps": steps, "options": asdict(options), **states}, temporary)


class _Batch(NamedTuple):
    """Tiles of a step, as tensors."""

    inputs: Tensor
    crater: Tensor
    weight: Tensor
    circle: Tensor


def _batch(made: Tiles) -> _Batch:
    inputs = torch.from_numpy(made.inputs[:, None]).contiguous(memory_format=torch.channels_last)
    return _Batch(inputs, *(torch.from_numpy(np.stack(part)) for part in zip(*made.targets, strict=True)))


def _rate(step: int, steps: int) -> float:
    """Rate of learning relative to the largest."""
    return min((step + 1) / _RISING, (steps - step) / (_FALLING_SHARE * steps), 1.0)


def _losses(seen: Tensor, made: _Batch) -> tuple[Tensor, Tensor]:
    """Logistic loss of the centres, and absolute errors of the circles, for each cell of a crater."""
    each = nn.functional.binary_cross_entropy_with_logits(seen[:, 0], made.crater, reduction="none")
    own = made.crater * made.weight
    count = own.sum().clamp(min=1.0)
    off = (seen[:, 1:] - made.circle).abs().sum(dim=1)
    return (each * made.weight).sum() / count, (off * own).sum() / count
