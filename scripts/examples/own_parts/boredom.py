"""A drive of one's own."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torch_iac import Candidates, Knowledge


@dataclass(frozen=True)
class Boredom:
    """Learning progress, less a fee for regions that are known well.

    worth(a) = progress(region of a) - weight * n_examples(region of a) / max_examples
    """

    needs: ClassVar[frozenset[str]] = frozenset()

    weight: float = 0.01
    """The fee of a full region, in units of scaled errors. An option: `--drive.weight 0.02`."""

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`, float64; higher is better."""
        n_examples = knowledge.examples.counts.take(candidates.rows)
        most = knowledge.examples.situations.shape[2] - 1
        return knowledge.history.progress.take(candidates.rows) - self.weight * n_examples / most
