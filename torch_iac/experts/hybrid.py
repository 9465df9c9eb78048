"""Experts that hold nearest neighbours alongside a network, and use the better of the two."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.network import MLPExperts, NetworkPool
from torch_iac.internal.state import Stateful, reserve
from torch_iac.internal.validation import check_count, settle
from torch_iac.regions.examples import Examples
from torch_iac.regions.tree import Split

ERROR_STEPS, MOST_ERROR = 2.0**30, 2.0**10
"""Errors are kept in whole steps of 2^-30, so that their sums are exact in any order; larger ones
count as 2^10, which is far beyond scaled units."""

NEIGHBOURS, NETWORK = 0, 1
"""Columns of the errors of each half."""


@dataclass(frozen=True, kw_only=True)
class HybridExperts:
    """Nearest neighbours and a network in each region: the one with the lower recent error is used.

    Both predict and learn at every decision of their region. Compared are their mean absolute
    errors, in scaled units, over the region's last `recent` decisions; the nearest neighbours are
    used where they are equal, as at first. Children take over their parent's errors.

    Raises:
        ValueError: `recent` is below 1 or too large.

    Source: this library; the papers allow any learner, and have one a region.
    """

    neighbours: KNNExperts = field(default_factory=KNNExperts)
    """The nearest neighbours."""
    network: MLPExperts = field(default_factory=MLPExperts)
    """The network beside them."""
    recent: int = 25
    """Over how many of a region's last errors the two are compared (this library's choice)."""

    def __post_init__(self) -> None:
        settle(self)
        check_count("recent", self.recent)

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "HybridPool":
        """Return the experts of a population, one pair for the root of each agent."""
        network = self.network.pool(situation_dim, outcome_dim, seeds, device)
        return HybridPool(self.neighbours, network, self.recent, len(seeds), device)


class HybridPool(Stateful):
    """The pairs of experts of the regions of a population.

    Args:
        neighbours: One half of each pair.
        network: The other half.
        recent: Over how many errors they are compared.
        n_agents: How many roots there are.
        device: Where the errors are kept.
    """

    saved = ("network",)
    tables: ClassVar = {"_n_rows": ("_errors", "_sums", "_n_errors")}

    def __init__(
        self,
        neighbours: KNNExperts,
        network: NetworkPool,
        recent: int,
        n_agents: int,
        device: torch.device,
    ) -> None:
        self.neighbours, self.network = neighbours, network
        self._n_rows, self._recent = n_agents, recent
        # The last errors of each row, `(L, 2, recent)`, in turn, their sums, and how many there
        # ever were.
        self._errors = torch.zeros(n_agents, 2, recent, dtype=torch.int64, device=device)
        self._sums = torch.zeros(n_agents, 2, dtype=torch.int64, device=device)
        self._n_errors = torch.zeros(n_agents, dtype=torch.int64, device=device)
        self._predicted: Tensor | None = None

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:
        """Return the predicted outcomes, shape `(A, K)`, in scaled units."""
        self._predicted = torch.stack(
            [pool.predict(examples, rows, situations) for pool in (self.neighbours, self.network)],
            dim=1,
        )
        used = self.uses_network(rows).long()[:, None, None]
        return self._predicted.gather(1, used.expand(-1, 1, self._predicted.shape[2]))[:, 0]

    def uses_network(self, rows: Tensor) -> Tensor:
        """Return whether the network is used in some regions, shape `(A,)`."""
        sums = self._sums.index_select(0, rows)
        return sums[:, NETWORK] < sums[:, NEIGHBOURS]

    def learn(self, examples: Examples, rows: Tensor, step: int) -> Tensor:
        """Record both errors, learn, and return the network's losses, shape `(A,)`.

        Args:
            examples: What the regions hold, the new ones last.
            rows: Shape `(A,)`, those of which `predict` was asked last.
            step: The number of the decision.

        Raises:
            RuntimeError: They were not asked to predict before.
        """
        if self._predicted is None or len(self._predicted) != len(rows):
            raise RuntimeError("experts must predict before they learn")
        outcomes = examples.outcomes[rows, :, examples.counts.take(rows) - 1]
        errors = (self._predicted - outcomes[:, None]).double().abs_().mean(dim=2)
        self._remember(rows, errors.clamp_(max=MOST_ERROR).mul_(ERROR_STEPS).round_().long())
        self._predicted = None
        return self.network.learn(examples, rows, step)

    def split(self, examples: Examples, split: Split) -> None:
        """Give the children networks, and the errors of their parents."""
        self._n_rows = split.n_rows
        for name in ("_errors", "_sums", "_n_errors"):
            column = reserve(getattr(self, name), split.n_rows)
            column[split.new_rows] = column[split.rows]
            setattr(self, name, column)
        self.network.split(examples, split)

    def expert(self, examples: Examples, row: int) -> Any:
        """Return a copy of the network of a region, or of its examples: of what is used there."""
        used = self.uses_network(torch.tensor([row], device=self._sums.device))
        pool = self.network if used else self.neighbours
        return pool.expert(examples, row)

    def _remember(self, rows: Tensor, errors: Tensor) -> None:
        """Replace the oldest errors by new ones, `(A, 2)`."""
        places = self._n_errors.take(rows) % self._recent
        self._sums[rows] += errors - self._errors[rows, :, places]
        self._errors[rows, :, places] = errors
        self._n_errors[rows] += 1
