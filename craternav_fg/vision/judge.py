"""Learned judgement of crater candidates: how probable it is that a candidate is a crater.

A small network sees the neighbourhood of a candidate, turned so that the sun is to the right, scaled to the
candidate's radius and freed of mean and contrast, beside the correlation with the canonical crater. It was
trained on rendered ground alone (`craternav_fg.training`); its model card is docs/howto/detection.md.
"""

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.vision.candidates import Candidates

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]

WEIGHTS = "judge.npz"
# Side of a patch in samples, and its half side in radii of the candidate.
PATCH_SIDE = 24
_PATCH_REACH_RADII = 1.75
# Candidates of this radius are sampled at the image's resolution, larger ones at that of their octave.
_OCTAVE_RADIUS_PX = 6.0
# Contrast below which a patch is noise, of 255.
_LEAST_CONTRAST = 1.0
# Typical correlation and radius, which centre the network's inputs.
_CORRELATION, _CORRELATION_SCALE, _RADIUS_PX = 0.62, 4.0, 12.0


@dataclass(frozen=True)
class Network:
    """Layers of rectified linear units, and a logistic output.

    Attributes
    ----------
    weights : tuple of ndarray, shape (inputs, outputs)
        Dimensionless.
    biases : tuple of ndarray, shape (outputs,)
        Dimensionless.
    """

    weights: tuple[Float32Array, ...]
    biases: tuple[Float32Array, ...]

    def log_odds(self, inputs: Float32Array) -> Float32Array:
        """Evaluate the network.

        Parameters
        ----------
        inputs : ndarray of float32, shape (n, inputs)
            See `features`, dimensionless.

        Returns
        -------
        ndarray of float32, shape (n,)
            Logarithm of the odds of a crater, a likelihood ratio.
        """
        values = inputs
        for k, (weights, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weights + bias
            if k + 1 < len(self.weights):
                values = np.maximum(values, np.float32(0.0))
        return np.asarray(values[:, 0])


@lru_cache(maxsize=1)
def network() -> Network:
    """Read the network that is shipped.

    Returns
    -------
    Network
    """
    with resources.files("craternav_fg.vision").joinpath(WEIGHTS).open("rb") as file, np.load(file) as stored:
        count = len(stored.files) // 2
        layers = [
            stored[f"{part}{k}"].astype(np.float32) for part in ("weights", "bias") for k in range(count)
        ]
    return Network(tuple(layers[:count]), tuple(layers[count:]))


def features(image: Float32Array, candidates: Candidates, sun_angles_rad: FloatArray) -> Float32Array:
    """Compute what the network sees of candidates.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    candidates : Candidates
        n candidates.
    sun_angles_rad : ndarray, shape (n,)
        Direction towards the sun in the image at each.

    Returns
    -------
    ndarray of float32, shape (n, k)
        The patch, PATCH_SIDE squared, row by row, in standard deviations of its brightness; correlation,
        cosine of the candidate's sun against its neighbours', contrast and radius, the last two as
        logarithms.
    """
    side = np.linspace(-1.0, 1.0, PATCH_SIDE, endpoint=False) + 1.0 / PATCH_SIDE
    u, v = np.meshgrid(_PATCH_REACH_RADII * side, _PATCH_REACH_RADII * side)
    octave = np.log2(np.maximum(candidates.radius_px, _OCTAVE_RADIUS_PX) / _OCTAVE_RADIUS_PX).astype(np.int64)
    out = np.zeros((len(candidates), PATCH_SIDE**2 + 4), np.float32)
    for level in np.unique(octave):
        shape = [max(round(n / 2.0**level), 1) for n in image.shape]
        small = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA) if level else image
        scale_y, scale_x = image.shape[0] / shape[0], image.shape[1] / shape[1]
        for k in np.flatnonzero(octave == level):
            cos, sin = np.cos(sun_angles_rad[k]), np.sin(sun_angles_rad[k])
            x = candidates.xy_px[k, 0] + candidates.radius_px[k] * (cos * u - sin * v)
            y = candidates.xy_px[k, 1] + candidates.radius_px[k] * (sin * u + cos * v)
            patch = cv2.remap(
                small, ((x + 0.5) / scale_x - 0.5).astype(np.float32),
                ((y + 0.5) / scale_y - 0.5).astype(np.float32), cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REFLECT,
            )  # fmt: skip
            out[k, :-4] = ((patch - patch.mean()) / (patch.std() + _LEAST_CONTRAST)).ravel()
    contrast = np.log(candidates.slope_contrast + 1e-3)
    out[:, -4] = _CORRELATION_SCALE * (candidates.correlation - _CORRELATION)
    out[:, -3] = np.cos(candidates.sun_angle_rad - sun_angles_rad)
    out[:, -2] = contrast - np.median(contrast) if len(contrast) else contrast
    out[:, -1] = np.log(candidates.radius_px / _RADIUS_PX)
    return out


def mirrored(inputs: Float32Array) -> Float32Array:
    """Mirror what the network sees across the direction towards the sun: a crater stays one.

    Parameters
    ----------
    inputs : ndarray of float32, shape (n, k)
        See `features`; dimensionless.

    Returns
    -------
    ndarray of float32, shape (n, k)
        Dimensionless.
    """
    out = inputs.copy()
    patches = inputs[:, :-4].reshape(-1, PATCH_SIDE, PATCH_SIDE)
    out[:, :-4] = patches[:, ::-1].reshape(len(inputs), -1)
    return out


def crater_probability(image: Float32Array, candidates: Candidates, sun_angles_rad: FloatArray) -> FloatArray:
    """Estimate how probable it is that candidates are craters.

    Parameters
    ----------
    image : ndarray of float32, shape (H, W)
        Brightness, 0 to 255, finite.
    candidates : Candidates
        n candidates.
    sun_angles_rad : ndarray, shape (n,)
        Direction towards the sun in the image at each.

    Returns
    -------
    ndarray, shape (n,)
        Probabilities.
    """
    seen = features(image, candidates, sun_angles_rad)
    log_odds = 0.5 * (network().log_odds(seen) + network().log_odds(mirrored(seen)))
    return np.asarray(1.0 / (1.0 + np.exp(-log_odds.astype(np.float64))))
