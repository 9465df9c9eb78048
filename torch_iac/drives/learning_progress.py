"""Drives: what a candidate action is worth to the robot.

A drive is a frozen dataclass with one method, `worth`. What it may use, besides the candidates, is
in `Knowledge`; parts that only some drives need are kept only if `needs` names them.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_iac.drives.protocol import Candidates, Knowledge, Need, known


@dataclass(frozen=True)
class Progress:
    """Intelligent Adaptive Curiosity: the last learning progress of the candidate's region.

    worth(a) = LP of the region that holds (a, sensors)

    Source: Oudeyer and Kaplan (2004), section 2.1.
    """

    needs: ClassVar[frozenset[Need]] = frozenset()

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        return knowledge.history.progress.take(candidates.rows)


@dataclass(frozen=True)
class MetaProgress:
    """The region's learning progress if its next error were what MP expects.

    worth(a) = LP of the region that holds (a, sensors), after the error MP(a, sensors)

    Source: Oudeyer and Kaplan (2004), the first definition of section 2.1 applied to regions.
    """

    needs: ClassVar[frozenset[Need]] = frozenset({"meta"})

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        expected = known(knowledge.meta, "meta").expect(candidates.situations)
        return knowledge.history.progress_after(candidates.rows, expected.double())


@dataclass(frozen=True)
class AbsoluteProgress:
    """The absolute learning progress of the candidate's region, for falling and growing errors.

    worth(a) = |LP of the region that holds (a, sensors)|

    Source: Baranes and Oudeyer (2013) and later work.
    """

    needs: ClassVar[frozenset[Need]] = frozenset()

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        return knowledge.history.progress.take(candidates.rows).abs()


@dataclass(frozen=True)
class GlobalProgress:
    """Progress over one history of all errors, if the next error were what MP expects.

    worth(a) = LP of all errors in succession, after the error MP(a, sensors)

    The method that the 2004 paper argues against: going from what is hard to predict to what is
    easy looks like progress.

    Source: Kaplan and Oudeyer (2003); Oudeyer and Kaplan (2004), section 2.1, first half.
    """

    needs: ClassVar[frozenset[Need]] = frozenset({"meta", "whole_history"})

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        expected = known(knowledge.meta, "meta").expect(candidates.situations).double()
        agents = torch.arange(len(expected), device=expected.device)[:, None].expand_as(expected)
        return known(knowledge.whole_history, "whole_history").progress_after(agents, expected)
