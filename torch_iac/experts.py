"""Experts: what predicts the outcome of a situation from the examples of its region."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from torch_iac.examples import NO_EXAMPLE_OUTCOME, Examples


@runtime_checkable
class Experts(Protocol):
    """One expert for each leaf of each agent."""

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:
        """Return the predicted outcomes, shape `(A, K)`, in scaled units.

        Args:
            examples: What the regions hold.
            rows: Shape `(A,)`, which leaf's expert is asked.
            situations: Shape `(A, D)`, in the unit cube.
        """


@dataclass(frozen=True)
class KNNExperts:
    """Nearest neighbours: the mean outcome of the `k` nearest examples of the region.

    Distance is Euclidean in the unit cube; ties go to the older example. With fewer than `k`
    examples all of them count; with none the prediction is 0.5.

    Source: Oudeyer and Kaplan (2004), section 2.1, which does not say `k`.
    """

    k: int = 1
    """How many neighbours are averaged."""

    def __post_init__(self) -> None:
        if self.k < 1:
            raise ValueError(f"k must be at least 1, got {self.k}")

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:
        """Return the predicted outcomes, shape `(A, K)`, in scaled units."""
        offsets = examples.situations.index_select(0, rows).sub_(situations[:, :, None])
        distances = offsets.square_().sum(dim=1)  # (A, N), squared
        if self.k == 1:
            return examples.outcomes[rows, :, distances.argmin(dim=1)]
        outcomes = examples.outcomes.index_select(0, rows)  # (A, K, N)
        nearest = distances.sort(dim=1, stable=True).indices[:, : self.k]
        is_example = distances.gather(1, nearest).isfinite()[:, None]
        neighbours = outcomes.gather(2, nearest[:, None].expand(-1, outcomes.shape[1], -1))
        n_neighbours = is_example.sum(-1)
        mean = (neighbours * is_example).sum(-1) / n_neighbours
        return torch.where(n_neighbours > 0, mean, NO_EXAMPLE_OUTCOME)
