"""Training of the network of `vision.judge`: Adam on the logistic loss, written out for two hidden layers."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from craternav_fg.vision.judge import Network, mirrored

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]

# Adam's usual constants: decay of the mean and of the square, and the least step's denominator.
_DECAY, _SQUARE_DECAY, _TINY = 0.9, 0.999, 1e-8


@dataclass(frozen=True)
class TrainingOptions:
    """How the network is trained.

    Attributes
    ----------
    hidden : tuple of int
        Units of the hidden layers.
    epochs, batch : int
    rate : float
        Learning rate at the start; it falls to zero by a cosine.
    weight_decay : float
    dropout : float
        Share of the inputs that are left out at random.
    """

    hidden: tuple[int, ...] = (96, 32)
    epochs: int = 25
    batch: int = 256
    rate: float = 1e-3
    weight_decay: float = 1e-4
    dropout: float = 0.1


def train(
    inputs: Float32Array,
    wanted: FloatArray,
    rng: np.random.Generator,
    options: TrainingOptions | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Network:
    """Train a network.

    Parameters
    ----------
    inputs : ndarray of float32, shape (n, inputs)
        See `vision.judge.features`; dimensionless.
    wanted : ndarray, shape (n,)
        1 for a crater, 0 for none: probabilities.
    rng : Generator
    options : TrainingOptions, optional
    progress : callable, optional
        Called after each epoch with its number and the mean loss.

    Returns
    -------
    Network
    """
    options = options or TrainingOptions()
    sizes = (inputs.shape[1], *options.hidden, 1)
    weights = [
        rng.normal(0.0, np.sqrt(2.0 / a), (a, b)).astype(np.float32) for a, b in itertools.pairwise(sizes)
    ]
    values = [*weights, *(np.zeros(b, np.float32) for b in sizes[1:])]
    means, squares = ([np.zeros_like(value) for value in values] for _ in range(2))
    layers, steps = len(weights), 0
    for epoch in range(options.epochs):
        rate = options.rate * 0.5 * (1.0 + np.cos(np.pi * epoch / options.epochs))
        order, losses = rng.permutation(len(inputs)), []
        for first in range(0, len(inputs) - options.batch + 1, options.batch):
            rows = order[first : first + options.batch]
            loss, slopes = _slopes(values, layers, _varied(inputs[rows], rng, options.dropout), wanted[rows])
            losses.append(loss)
            steps += 1
            for k, slope in enumerate(slopes):
                if k < layers:
                    slope += options.weight_decay * values[k]
                means[k] += (1.0 - _DECAY) * (slope - means[k])
                squares[k] += (1.0 - _SQUARE_DECAY) * (slope * slope - squares[k])
                mean, square = means[k] / (1.0 - _DECAY**steps), squares[k] / (1.0 - _SQUARE_DECAY**steps)
                values[k] -= (rate * mean / (np.sqrt(square) + _TINY)).astype(np.float32)
        if progress is not None:
            progress(epoch + 1, float(np.mean(losses)))
    return Network(tuple(values[:layers]), tuple(values[layers:]))


def _varied(inputs: Float32Array, rng: np.random.Generator, dropout: float) -> Float32Array:
    """Mirror half of the patches, and leave samples of all out."""
    flip = rng.random(len(inputs)) < 0.5
    out = np.where(flip[:, None], mirrored(inputs), inputs)
    out[:, :-4] *= rng.random((len(out), out.shape[1] - 4)) > dropout
    return np.asarray(out, dtype=np.float32)


def _slopes(
    values: list[Float32Array], layers: int, inputs: Float32Array, wanted: FloatArray
) -> tuple[float, list[Float32Array]]:
    """Mean loss of a batch, and its derivatives in weights and biases."""
    outputs = [inputs]
    for k in range(layers):
        z = outputs[-1] @ values[k] + values[layers + k]
        outputs.append(np.maximum(z, 0.0) if k + 1 < layers else z)
    log_odds = outputs[-1][:, 0].astype(np.float64)
    loss = float(np.mean(np.logaddexp(0.0, log_odds) - wanted * log_odds))
    slope = ((1.0 / (1.0 + np.exp(-log_odds)) - wanted) / len(wanted)).astype(np.float32)[:, None]
    out = [np.empty(0, np.float32)] * (2 * layers)
    for k in range(layers - 1, -1, -1):
        out[k], out[layers + k] = outputs[k].T @ slope, slope.sum(axis=0)
        if k:
            slope = (slope @ values[k].T) * (outputs[k] > 0.0)
    return loss, out
