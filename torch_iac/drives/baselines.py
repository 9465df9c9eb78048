"""Drives to compare with: error, novelty, improvement, and none."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor

from torch_iac.drives.protocol import Candidates, Knowledge, Need, known
from torch_iac.internal import kernels
from torch_iac.internal.validation import settle


@dataclass(frozen=True)
class Error:
    """The expected error: go where it is least predictable.

    worth(a) = mean error of the region that holds (a, sensors), or MP(a, sensors)

    Raises:
        ValueError: `source` is neither "region" nor "meta".

    Source: the naive curiosity that the 2004 paper rejects; with "region", MAX in Oudeyer, Kaplan
    and Hafner (2007).
    """

    source: Literal["region", "meta"] = "region"
    """Whose expectation: the mean of the region's last errors (0 without any), or MP's."""

    def __post_init__(self) -> None:
        settle(self)

    @property
    def needs(self) -> frozenset[Need]:
        """Which optional parts of the knowledge the drive looks at."""
        return frozenset({"meta"}) if self.source == "meta" else frozenset()

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        if self.source == "meta":
            return known(knowledge.meta, "meta").expect(candidates.situations).double()
        return knowledge.history.mean_error(candidates.rows).nan_to_num_(0.0)


@dataclass(frozen=True)
class Novelty:
    """The distance to the nearest example in the region: go where it is most novel.

    worth(a) = least Euclidean distance of (a, sensors) to an example of its region

    in the unit cube; without any example it is infinite.

    Source: the naive curiosity that the 2004 paper rejects.
    """

    needs: ClassVar[frozenset[Need]] = frozenset()

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        squares = torch.zeros((), device=candidates.rows.device)
        for dimension in range(candidates.situations.shape[2]):  # keeps memory at (A, C, N)
            held = knowledge.examples.situations[:, dimension].index_select(
                0, candidates.rows.flatten()
            )
            offsets = held.view(*candidates.rows.shape, -1)
            squares = squares + (offsets - candidates.situations[:, :, dimension, None]).square()
        return kernels.sqrt(squares.amin(dim=2)).double()


@dataclass(frozen=True)
class Improvement:
    """How much learning from the situation is expected to lower the error there.

    worth(a) = a network's expectation of (error before learning) - (error after it) at (a, sensors)

    Source: Schmidhuber (1991).
    """

    needs: ClassVar[frozenset[Need]] = frozenset({"improvement"})

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        return known(knowledge.improvement, "improvement").predict(candidates.situations).double()


@dataclass(frozen=True)
class Random:
    """The baseline: every candidate is worth the same, so actions are uniformly random.

    Source: RANDOM in Oudeyer, Kaplan and Hafner (2007).
    """

    needs: ClassVar[frozenset[Need]] = frozenset()

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        return knowledge.history.progress.new_zeros(candidates.rows.shape)
