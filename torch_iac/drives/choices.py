"""Choices: which candidate is taken, given what each is worth."""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from torch_iac.internal import kernels
from torch_iac.internal.validation import settle


@runtime_checkable
class Choice(Protocol):
    """Picks one candidate for each agent."""

    def pick(self, worth: Tensor, numbers: Tensor) -> Tensor:
        """Return which candidate each agent takes, shape `(A,)`.

        Args:
            worth: Shape `(A, C)`, float64; infinite worth is allowed.
            numbers: Shape `(A,)`, uniform random numbers over [0, 1).
        """


@dataclass(frozen=True)
class Greedy:
    """The candidate that is worth most; ties at random.

    Example:
        >>> Greedy().pick(torch.tensor([[0.1, 0.4, 0.2]]), torch.rand(1))
        tensor([1])

    Source: Oudeyer and Kaplan (2004), section 2.1.
    """

    def pick(self, worth: Tensor, numbers: Tensor) -> Tensor:  # noqa: ARG002
        """Return which candidate each agent takes, shape `(A,)`."""
        # Candidates are drawn independently, so the first of the best is a random one of them.
        return worth.argmax(dim=1)


@dataclass(frozen=True)
class Proportional:
    """A candidate with a probability in proportion to what it is worth.

    P(a) = max(worth(a), 0) / sum of the same over all candidates

    and uniform where nothing is worth more than 0, or among those of infinite worth.

    Source: Baranes and Oudeyer (2013), who choose regions in this way, by absolute progress.
    """

    def pick(self, worth: Tensor, numbers: Tensor) -> Tensor:
        """Return which candidate each agent takes, shape `(A,)`."""
        weights = worth.clamp(min=0.0)
        return _sample(worth, weights + (weights.sum(dim=1, keepdim=True) == 0), numbers)


@dataclass(frozen=True)
class Softmax:
    """A candidate with a probability that grows exponentially with what it is worth.

    P(a) = exp(worth(a) / temperature) / sum of the same over all candidates

    and uniform among those of infinite worth.

    Raises:
        ValueError: The temperature is not finite and above 0.

    Source: the usual rule of reinforcement learning, which the 2004 paper leaves open.
    """

    temperature: float = 0.01
    """By how much more worth an action is e times as probable; for progress, in scaled units."""

    def __post_init__(self) -> None:
        settle(self)
        if not 0 < self.temperature < math.inf:
            raise ValueError(f"temperature must be above 0 and finite, got {self.temperature}")

    def pick(self, worth: Tensor, numbers: Tensor) -> Tensor:
        """Return which candidate each agent takes, shape `(A,)`."""
        # The best is subtracted, so that a low temperature does not overflow.
        below = worth - worth.amax(dim=1, keepdim=True)
        return _sample(worth, kernels.exp(below / self.temperature), numbers)


def _sample(worth: Tensor, weights: Tensor, numbers: Tensor) -> Tensor:
    """Return, for each row, a place drawn in proportion to the weights or among infinite worth."""
    infinite = worth == math.inf
    weights = torch.where(infinite.any(dim=1, keepdim=True), infinite.double(), weights)
    sums = weights.cumsum(dim=1)
    marks = numbers[:, None] * sums[:, -1:]
    return (sums <= marks).sum(dim=1).clamp_(max=weights.shape[1] - 1)
