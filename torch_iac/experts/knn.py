"""Experts that are nearest neighbours.

A kind of expert (`KNNExperts`, `MLPExperts`, ...) is a frozen dataclass, part of the config; its
`pool` makes the experts themselves, one for each leaf of each agent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from torch_iac.internal import kernels
from torch_iac.internal.state import Stateful
from torch_iac.internal.validation import check_count, settle
from torch_iac.regions.examples import NO_EXAMPLE_OUTCOME, Examples, RegionExamples
from torch_iac.regions.tree import Split


@dataclass(frozen=True)
class KNNExperts(Stateful):
    """Nearest neighbours: the mean outcome of the `k` nearest examples of the region.

    Distance is Euclidean in the unit cube; ties go to the older example. With fewer than `k`
    examples all of them count; with none the prediction is 0.5.

    Raises:
        ValueError: `k` is below 1 or too large.

    Source: Oudeyer and Kaplan (2004), section 2.1, which says neither `k` nor the distance.
    """

    k: int = 1
    """How many neighbours are averaged (the papers do not say)."""

    def __post_init__(self) -> None:
        settle(self)
        check_count("k", self.k)

    def pool(
        self,
        situation_dim: int,  # noqa: ARG002 - the examples are all there is
        outcome_dim: int,  # noqa: ARG002
        seeds: Sequence[int],  # noqa: ARG002
        device: torch.device,  # noqa: ARG002
    ) -> Self:
        """Return itself: nearest neighbours have no state but the examples."""
        return self

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:
        """Return the predicted outcomes, shape `(A, K)`, in scaled units."""
        distances = kernels.squared_distances(examples.situations, rows, situations)  # (A, N)
        if self.k == 1:
            return examples.outcomes[rows, :, _first_least(distances)]
        outcomes = examples.outcomes.index_select(0, rows)  # (A, K, N)
        nearest = distances.sort(dim=1, stable=True).indices[:, : self.k]
        is_example = distances.gather(1, nearest).isfinite()[:, None]
        neighbours = outcomes.gather(2, nearest[:, None].expand(-1, outcomes.shape[1], -1))
        n_neighbours = is_example.sum(-1)
        # Outcomes are multiples of `UNIT_STEP`: in float64 their sum is exact in any order.
        mean = (neighbours * is_example).double().sum(-1) / n_neighbours
        return torch.where(n_neighbours > 0, mean, NO_EXAMPLE_OUTCOME).float()

    def learn(self, examples: Examples, rows: Tensor, step: int) -> None:
        """Do nothing, for rows `(A,)`: the example is stored already."""

    def split(self, examples: Examples, split: Split) -> None:
        """Do nothing: the examples are divided already."""

    def expert(self, examples: Examples, row: int) -> RegionExamples:
        """Return a copy of the examples of a region, among which the nearest are searched."""
        return examples.of(row)


def _first_least(distances: Tensor) -> Tensor:
    """Return where the least of each row is, the first of equal ones, shape `(A,)`."""
    if distances.device.type == "cpu":  # where numpy is six times as fast
        return torch.from_numpy(distances.numpy().argmin(axis=1))
    return distances.argmin(dim=1)
