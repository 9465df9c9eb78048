"""The examples that each region holds.

Every leaf of every agent has one *row*, its own place in the tables of examples, of error histories
and of network weights. Rows are allocated as leaves appear, over all agents, so that memory
grows with the number of leaves and not with the largest tree. `L` is the number of rows.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_iac.internal.state import Stateful, reserve
from torch_iac.regions.tree import Split

NO_EXAMPLE_OUTCOME = 0.5
"""What is predicted without any example, in scaled units: the middle (the papers do not say)."""


@dataclass(frozen=True)
class RegionExamples:
    """What one region holds, oldest first.

    Attributes:
        situations: Shape `(N, D)`, in the unit cube.
        outcomes: Shape `(N, K)`, in scaled units.
    """

    situations: Tensor
    outcomes: Tensor


class Examples(Stateful):
    """The examples of each leaf, oldest first.

    Args:
        n_rows: How many leaves there are at first.
        situation_dim: D.
        outcome_dim: K.
        max_examples: How many examples a leaf may keep; there is room for one more, N in all.
        device: Where the examples are kept.

    Attributes:
        situations: Shape `(L, D, N)`, in the unit cube; infinite where there is no example, so
            that an absent example is never the nearest.
        outcomes: Shape `(L, K, N)`, in scaled units; `NO_EXAMPLE_OUTCOME` where there is none.
        counts: Shape `(L,)`, how many examples each row holds.
        n_rows: How many rows are in use.

    Source: Oudeyer and Kaplan (2004), section 2.1: each example belongs to one expert.
    """

    tables: ClassVar = {"n_rows": ("situations", "outcomes", "counts")}

    def __init__(
        self,
        n_rows: int,
        situation_dim: int,
        outcome_dim: int,
        max_examples: int,
        device: torch.device,
    ) -> None:
        self.n_rows = n_rows
        # One place more than a region may keep: the example that makes it split.
        size = max_examples + 1
        self.situations = torch.full((n_rows, situation_dim, size), math.inf, device=device)
        self.outcomes = torch.full((n_rows, outcome_dim, size), NO_EXAMPLE_OUTCOME, device=device)
        self.counts = torch.zeros(n_rows, dtype=torch.int64, device=device)

    def add(self, rows: Tensor, situations: Tensor, outcomes: Tensor) -> Tensor:
        """Store one example in each of some different rows.

        Args:
            rows: Shape `(A,)`.
            situations: Shape `(A, D)`, in the unit cube.
            outcomes: Shape `(A, K)`, in scaled units.

        Returns:
            Shape `(A,)`, how many examples each of them holds now.
        """
        counts = self.counts.take(rows)
        self.situations[rows, :, counts] = situations
        self.outcomes[rows, :, counts] = outcomes
        counts += 1
        self.counts.index_copy_(0, rows, counts)
        return counts

    def of(self, row: int) -> RegionExamples:
        """Return a copy of what a leaf holds."""
        n = int(self.counts[row])
        situations, outcomes = self.situations[row, :, :n], self.outcomes[row, :, :n]
        return RegionExamples(situations.mT.clone(), outcomes.mT.clone())

    def split(self, split: Split, goes_right: Tensor) -> None:
        """Divide the examples of regions between their children, each side in order of age.

        Args:
            split: The regions that split.
            goes_right: Shape `(F, N)`, which examples go to the right child.
        """
        self.n_rows = split.n_rows
        self.situations = reserve(self.situations, split.n_rows)
        self.outcomes = reserve(self.outcomes, split.n_rows)
        self.counts = reserve(self.counts, split.n_rows)
        parents, children = split.rows.repeat(2), torch.cat([split.rows, split.new_rows])
        goes = torch.cat([~goes_right, goes_right])  # (2F, N), to the left child, to the right one
        order = goes.to(torch.int8).sort(dim=-1, descending=True, stable=True).indices
        self.counts[children] = counts = goes.sum(-1)
        absent = torch.arange(goes.shape[-1], device=goes.device) >= counts[:, None]
        for column, fill in ((self.situations, math.inf), (self.outcomes, NO_EXAMPLE_OUTCOME)):
            column[children] = _arrange(column[parents], order, absent, fill)

    def forget_oldest(self, rows: Tensor) -> None:
        """Drop the oldest example of full rows, shape `(F,)`."""
        self.counts[rows] -= 1
        for column, fill in ((self.situations, math.inf), (self.outcomes, NO_EXAMPLE_OUTCOME)):
            kept = column[rows].roll(-1, dims=-1)
            kept[..., -1] = fill
            column[rows] = kept


def _arrange(examples: Tensor, order: Tensor, absent: Tensor, fill: float) -> Tensor:
    """Reorder the last dimension of `(F, ., N)` by `(F, N)` and fill absent places."""
    arranged = examples.gather(-1, order[:, None].expand_as(examples))
    return arranged.masked_fill_(absent[:, None], fill)
