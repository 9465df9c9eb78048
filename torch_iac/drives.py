"""Drives: what a candidate action is worth to the robot."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torch import Tensor

from torch_iac.progress import ErrorHistory


@dataclass(frozen=True)
class Candidates:
    """The actions that each agent may take now, each with the present sensors: situations.

    Attributes:
        situations: Shape `(A, C, D)`, in the unit cube.
        rows: Shape `(A, C)`, the leaf that holds each of them.
    """

    situations: Tensor
    rows: Tensor


@runtime_checkable
class Drive(Protocol):
    """Says what candidates are worth; the agent takes the best."""

    def worth(self, candidates: Candidates, history: ErrorHistory) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`; higher is better."""


@dataclass(frozen=True)
class Progress:
    """Intelligent Adaptive Curiosity: the last learning progress of the candidate's region.

    worth(a) = LP of the region that holds (a, sensors)

    Source: Oudeyer and Kaplan (2004), section 2.1.
    """

    def worth(self, candidates: Candidates, history: ErrorHistory) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        return history.progress.take(candidates.rows)


@dataclass(frozen=True)
class Random:
    """The baseline: nothing is worth more than anything else, so actions are uniformly random."""

    def worth(self, candidates: Candidates, history: ErrorHistory) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        return history.progress.new_zeros(candidates.rows.shape)
