"""The crater network that is shipped: a small convolutional detector, run by OpenCV.

It knows craters lit from about the right, of one octave of radii, and was trained on rendered ground alone
(`craternav_fg.training`); its model card is in the documentation.
"""

import threading
from functools import cache
from importlib import resources

import cv2
import numpy as np
import numpy.typing as npt

from craternav_fg.errors import InputError

Float32Array = npt.NDArray[np.float32]

WEIGHTS = "craters.onnx"
# The sides of what the network sees are multiples of this.
_MULTIPLE_PX = 16
_INPUT, _OUTPUT = "image", "cells"
# OpenCV's network keeps what it computes in itself: each thread has its own.
_of_thread = threading.local()


def cells(values: Float32Array) -> Float32Array:
    """Evaluate the network.

    Parameters
    ----------
    values : ndarray of float32, shape (h, w)
        Of `pyramid.normalised`.

    Returns
    -------
    ndarray of float32, shape (4, rows, columns)
        Of each cell of `pyramid.STRIDE_PX`: logarithm of the odds that a crater's centre is in it; from the
        cell to the centre, x and y, in cells; logarithm of the radius over the geometric mean of
        `pyramid.LEAST_PX` and `MOST_PX`.

    Raises
    ------
    InputError
        When the weights are missing or damaged.
    """
    height, width = values.shape
    padded = np.zeros((1, 1, *(-(-n // _MULTIPLE_PX) * _MULTIPLE_PX for n in values.shape)), np.float32)
    padded[0, 0, :height, :width] = values
    network = _network()
    network.setInput(padded, _INPUT)
    return np.asarray(network.forward(_OUTPUT)[0], np.float32)


def _network() -> cv2.dnn.Net:
    """Return the thread's network."""
    if not hasattr(_of_thread, "network"):
        try:
            network = cv2.dnn.readNetFromONNX(np.frombuffer(_weights(), np.uint8))
        except cv2.error as error:
            raise InputError(WEIGHTS, f"expected a network of the package: {error}") from None
        _of_thread.network = network
    kept: cv2.dnn.Net = _of_thread.network
    return kept


@cache
def _weights() -> bytes:
    try:
        return resources.files("craternav_fg.vision").joinpath(WEIGHTS).read_bytes()
    except OSError as error:
        raise InputError(WEIGHTS, f"expected a file of the package: {error.strerror}") from None
