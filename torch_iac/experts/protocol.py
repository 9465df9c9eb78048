"""The protocol of experts: predict, learn, split."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from torch_iac.regions.examples import Examples
from torch_iac.regions.tree import Split


class ExpertPool(Protocol):
    """The experts of a population, one for each row.

    Runs are saved and resumed only with experts that are `Resumable` too.
    """

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:
        """Return the predicted outcomes, shape `(A, K)`, in scaled units.

        Args:
            examples: What the regions hold.
            rows: Shape `(A,)`, which experts are asked.
            situations: Shape `(A, D)`, in the unit cube.
        """

    def learn(self, examples: Examples, rows: Tensor, step: int) -> Tensor | None:
        """Learn, now that each of some rows has a new example.

        Args:
            examples: What the regions hold, the new ones last.
            rows: Shape `(A,)`, one an agent.
            step: The number of the decision.

        Returns:
            Shape `(A,)`, a loss that must be finite; None if there is none.
        """

    def split(self, examples: Examples, split: Split) -> None:
        """Make experts for the children of regions, whose examples are divided already.

        Args:
            examples: What the regions hold now.
            split: The regions that split.
        """


@runtime_checkable
class Experts(Protocol):
    """A kind of expert."""

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> ExpertPool:
        """Return the experts of a population, one for the root of each agent.

        Args:
            situation_dim: D.
            outcome_dim: K.
            seeds: One for each agent.
            device: Where they learn.

        Raises:
            ValueError: There can be no such experts.
        """
