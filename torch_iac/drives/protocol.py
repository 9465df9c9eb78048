"""The protocol of drives, and what a drive may use."""

from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar, runtime_checkable

from torch import Tensor

from torch_iac.meta_predictor import ErrorExpectation, RecentNetworks
from torch_iac.regions.error_history import ErrorHistory
from torch_iac.regions.examples import Examples
from torch_iac.space import SensorimotorSpace

Part = TypeVar("Part")
"""The kind of a part of the knowledge."""

Need = Literal["meta", "whole_history", "improvement"]
"""Parts of the knowledge that are kept only for drives that name them in `needs`."""


@dataclass(frozen=True)
class Candidates:
    """The candidate actions of each agent, each with the present sensors, as situations.

    Attributes:
        situations: Shape `(A, C, D)`, in the unit cube.
        rows: Shape `(A, C)`, the leaf that holds each of them.
    """

    situations: Tensor
    rows: Tensor


@dataclass(frozen=True)
class Knowledge:
    """What the agents have learnt when they choose.

    Attributes:
        step: The number of the decision.
        space: What the robots do, sense and predict.
        examples: What each region holds.
        history: Each region's errors and progress.
        meta: MP; None without one.
        whole_history: Each agent's errors in all regions together, one row an agent; None unless
            the drive needs it.
        improvement: What each agent learns of how much an update improves a prediction; None
            without it.
    """

    step: int
    space: SensorimotorSpace
    examples: Examples
    history: ErrorHistory
    meta: ErrorExpectation | None
    whole_history: ErrorHistory | None
    improvement: RecentNetworks | None


@runtime_checkable
class Drive(Protocol):
    """Says what candidates are worth, by which the agent chooses one."""

    @property
    def needs(self) -> frozenset[Need]:
        """Which optional parts of the knowledge the drive uses."""

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`, float64; higher is better.

        The units are the drive's own: those of progress and of errors are scaled.
        """


def known(part: Part | None, name: Need) -> Part:
    """Return an optional part of the knowledge.

    Raises:
        RuntimeError: It is not kept, since the drive's `needs` do not name it.
    """
    if part is None:
        raise RuntimeError(f"a drive must name what it looks at in its needs, got none of {name}")
    return part
