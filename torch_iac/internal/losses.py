"""Losses of networks, and their gradients."""

from collections.abc import Callable

import torch
from torch import Tensor

Loss = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Compares predictions with targets, both `(A, B, K)`, element by element: returns the losses, and
their derivatives by the predictions."""

SMALL_ERROR = 1e-4
"""Added to errors before their logarithm is learnt, so that an expected error of 0 stays finite;
subtracted again from predictions."""


def squared_error(predictions: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Return the squared error of each prediction, and its derivative; all of one shape."""
    difference = predictions - targets
    return difference.square(), difference.mul_(2)


def gamma_loss(outputs: Tensor, errors: Tensor) -> tuple[Tensor, Tensor]:
    """Return MP's loss, least for log(mean error + `SMALL_ERROR`), and its derivative.

    All are of one shape; errors are in scaled units.
    """
    ratio = (errors + SMALL_ERROR) * torch.exp(-outputs)
    return ratio + outputs, 1 - ratio


LOSSES: tuple[Loss, ...] = (squared_error, gamma_loss)
"""The losses that `kernels.train_perceptrons` knows, in its order."""
