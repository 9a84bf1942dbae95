"""The crater network, and its export as ONNX (PyTorch, extra `train`).

One small fully convolutional network sees all levels of an image's pyramid (`vision.pyramid`). For each cell
of 4 x 4 px it tells the logarithm of the odds that a crater's centre is there, and the crater's circle.
"""

from pathlib import Path

import torch
from torch import Tensor, nn

from craternav_fg.files import replacing

# Odds of a crater at a cell before training.
_PRIOR_LOG_ODDS = -4.0


class _Residual(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(*_convolution(channels, channels), *_convolution(channels, channels)[:2])

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.body(x))


def _convolution(inputs: int, outputs: int, stride: int = 1, side: int = 3) -> list[nn.Module]:
    return [
        nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(),
    ]  # fmt: skip


class CraterNetwork(nn.Module):
    """Three resolutions, of 4, 8 and 16 px; the output has that of 4 px.

    Parameters
    ----------
    channels : tuple of int
        At half resolution and at the three others.
    """

    def __init__(self, channels: tuple[int, int, int, int] = (16, 40, 64, 96)) -> None:
        super().__init__()
        half, fine, middle, coarse = channels
        self.stem = nn.Sequential(*_convolution(1, half, 2, 5), *_convolution(half, fine, 2))
        self.fine = nn.Sequential(_Residual(fine), _Residual(fine))
        self.middle = nn.Sequential(*_convolution(fine, middle, 2), _Residual(middle), _Residual(middle))
        self.coarse = nn.Sequential(*_convolution(middle, coarse, 2), _Residual(coarse), _Residual(coarse))
        self.to_middle = nn.Conv2d(coarse, middle, 1)
        self.join_middle = nn.Sequential(*_convolution(middle, middle))
        self.to_fine = nn.Conv2d(middle, fine, 1)
        self.head = nn.Sequential(*_convolution(fine, fine), *_convolution(fine, fine), nn.Conv2d(fine, 4, 1))
        self.finer = nn.Upsample(scale_factor=2, mode="nearest")
        last = self.head[-1]
        nn.init.normal_(last.weight, std=0.01)
        nn.init.constant_(last.bias, 0.0)
        last.bias.data[0] = _PRIOR_LOG_ODDS

    def forward(self, x: Tensor) -> Tensor:
        """Evaluate the network.

        Parameters
        ----------
        x : Tensor, shape (n, 1, H, W)
            Of `pyramid.normalised`; H and W multiples of 16.

        Returns
        -------
        Tensor, shape (n, 4, H / 4, W / 4)
            Logarithm of the odds, and the circle as in `targets.Target`.
        """
        fine = self.fine(self.stem(x))
        middle = self.middle(fine)
        middle = self.join_middle(middle + self.finer(self.to_middle(self.coarse(middle))))
        return self.head(fine + self.finer(self.to_fine(middle)))


def export(network: CraterNetwork, path: Path) -> None:
    """Write a network as ONNX, for images of any size.

    Parameters
    ----------
    network : CraterNetwork
    path : Path
    """
    sizes = {"image": {0: "n", 2: "height", 3: "width"}, "cells": {0: "n", 2: "rows", 3: "columns"}}
    with replacing(path) as temporary:
        torch.onnx.export(
            network.eval().float(), (torch.zeros(1, 1, 64, 64),), str(temporary), input_names=["image"],
            output_names=["cells"], dynamic_axes=sizes, opset_version=13, dynamo=False,
        )  # fmt: skip
