"""Losses: what networks make smaller, and its slopes."""

from collections.abc import Callable

import torch
from torch import Tensor

Loss = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Compares predictions with targets, both `(A, B, K)`, element by element: the losses, and their
slopes, the derivatives by the predictions."""

SMALL_ERROR = 1e-4
"""Added to errors before their logarithm is learnt, so that MP can come back from expecting none;
taken off again when it is asked."""


def squared_error(predictions: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Return the squared error of each prediction, and its slope; all of one shape."""
    difference = predictions - targets
    return difference.square(), difference.mul_(2)


def gamma_loss(outputs: Tensor, errors: Tensor) -> tuple[Tensor, Tensor]:
    """Return what MP makes smaller, least for log(mean error + `SMALL_ERROR`), and its slope.

    All are of one shape; errors are in scaled units.
    """
    ratio = (errors + SMALL_ERROR) * torch.exp(-outputs)
    return ratio + outputs, 1 - ratio


LOSSES: tuple[Loss, ...] = (squared_error, gamma_loss)
"""The losses that `kernels.train_perceptrons` knows, in its order."""
