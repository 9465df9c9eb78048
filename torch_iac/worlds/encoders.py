"""Encoders: frozen networks that make features, which the robot senses, of pictures."""

from copy import deepcopy
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import adaptive_avg_pool2d, conv2d

from torch_iac.internal.generators import DrawnFrom
from torch_iac.internal.parts import import_object, make_importable
from torch_iac.internal.randomness import RandomStream
from torch_iac.internal.torch_defaults import with_torch_defaults

CONVOLUTION, PIXELS = "convolution", "pixels"
"""The library's own encoder, and none at all: each pixel is a sensor."""

SEED = 0
"""Seed of an encoder's weights, whatever the robots' seeds."""

N_MAPS = 8
"""How many maps each layer of the random convolution makes."""

WHITE = 255
"""The brightest that a pixel can be."""


def check_encoder(name: str) -> None:
    """Refuse a name that is none of an encoder.

    Raises:
        ValueError: It is neither `convolution` nor `pixels` nor written `module:Name`.
    """
    if name not in (CONVOLUTION, PIXELS) and ":" not in name:
        raise ValueError(f"encoder must be {CONVOLUTION}, {PIXELS} or module:Name, got {name}")


class RandomConvolution(nn.Module):
    """Two layers of random convolutions, averaged over the quarters of the picture: 32 features.

    Random features keep what differs between pictures, and never change (Burda et al., 2019).
    Weights are 1 or -1 and pixels whole numbers, so that all sums are exact: features are the same
    to the bit on every machine.

    Args:
        n_channels: How many colours a pixel has.

    Source: Burda, Edwards, Pathak, Storkey, Darrell and Efros (2019), "Large-Scale Study of
    Curiosity-Driven Learning", section 2.1.
    """

    def __init__(self, n_channels: int) -> None:
        super().__init__()
        self.first = nn.Buffer(_signs(0, N_MAPS, n_channels, 3, 3))
        self.second = nn.Buffer(_signs(1, N_MAPS, N_MAPS, 3, 3))

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the features, shape `(n, 32)`, of pictures `(n, C, H, W)` in [0, 1]."""
        pixels = (pictures.double() * WHITE).round()
        edges = conv2d(pixels, self.first, stride=2, padding=1).relu()
        shapes = conv2d(edges, self.second, stride=2, padding=1).relu()
        return adaptive_avg_pool2d(shapes, 2).flatten(1)


def _signs(stream: int, *shape: int) -> Tensor:
    """Return random weights, 1 or -1, from one of the encoder's streams."""
    drawn = RandomStream([SEED], prod(shape), stream, torch.device("cpu")).at(0)
    return torch.where(drawn < 0.5, -1.0, 1.0).double().reshape(shape)


class Encoder:
    """A frozen module that makes features of pictures of one shape.

    The module gets pictures as PyTorch's networks expect them: a tensor `(1, C, H, W)`, float32, in
    [0, 1]. All that it returns for one is its features. It is in evaluation mode, and its weights
    are made from a fixed seed.

    Args:
        name: `convolution`, or `module:Name`: a `torch.nn.Module`, or a class or a function that
            makes one without arguments.
        shape: That of a picture: `(H, W)`, `(H, W, C)` or `(C, H, W)`; of the first and the last
            dimension the smaller is the colours.

    Attributes:
        n_features: How many features a picture has.

    Raises:
        ValueError: It cannot be imported, is no module or takes no such pictures.
    """

    @with_torch_defaults
    def __init__(self, name: str, shape: tuple[int, ...]) -> None:
        self._colours_first = len(shape) == 3 and shape[0] < shape[2]
        black = torch.from_numpy(self._arranged(np.zeros(shape, np.uint8)))
        with DrawnFrom(torch.Generator().manual_seed(SEED)):
            self._module = _module(name, black.shape[0])
            self.n_features = self._trial(name, black[None].float())

    @with_torch_defaults
    @torch.inference_mode()
    def __call__(self, picture: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return the features of a picture, shape `(n_features,)`."""
        pixels = torch.from_numpy(self._arranged(picture).copy())  # worlds reuse their buffers
        features = self._module(pixels[None].float() / WHITE)
        return np.asarray(features.double().flatten().numpy())

    @torch.inference_mode()
    def _trial(self, name: str, picture: Tensor) -> int:
        """Return how many features the module makes of a picture."""
        try:
            features = self._module(picture)
        except Exception as error:  # whatever the user's module does
            raise ValueError(
                f"encoder must take pictures of the shape {tuple(picture.shape)}, got {name} "
                f"({type(error).__name__}: {error})"
            ) from error
        if not (isinstance(features, Tensor) and len(features) == 1 and features.numel()):
            got = tuple(features.shape) if isinstance(features, Tensor) else type(features).__name__
            raise ValueError(
                f"encoder must return a tensor of the shape (1, features), got {got} from {name}"
            )
        return features.numel()

    def _arranged(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a picture in the shape `(C, H, W)`."""
        picture = np.asarray(picture)
        if picture.ndim == 2:
            return picture[None]
        return picture if self._colours_first else np.moveaxis(picture, 2, 0)


def _module(name: str, n_channels: int) -> nn.Module:
    """Return an encoder's module, in evaluation mode."""
    if name == CONVOLUTION:
        return RandomConvolution(n_channels)
    make_importable(Path.cwd())
    made: Any = import_object(name, "encoder")
    if not isinstance(made, nn.Module):
        try:
            made = made()
        except TypeError as error:
            raise ValueError(
                f"encoder must be made without arguments, got {name} ({error})"
            ) from None
    if not isinstance(made, nn.Module):
        raise ValueError(f"encoder must be or make a torch.nn.Module, got {name}")
    return deepcopy(made).eval()  # one that its owner may train stays as it was
