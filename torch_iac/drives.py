"""Drives: what a candidate action is worth to the robot.

A drive is a frozen bundle of numbers with one method, `worth`. What it may look at, besides the
candidates, is in `Knowledge`; parts that only some drives need are kept only if `needs` names them.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, TypeVar, runtime_checkable

import torch
from torch import Tensor

from torch_iac import kernels
from torch_iac.counts import check_count
from torch_iac.examples import Examples
from torch_iac.meta import ErrorExpectation, RecentNetworks
from torch_iac.progress import ErrorHistory
from torch_iac.space import SensorimotorSpace

Part = TypeVar("Part")
"""The kind of a part of the knowledge."""

Need = Literal["meta", "whole_history", "improvement"]
"""Parts of the knowledge that are kept only for drives that name them in `needs`."""


@dataclass(frozen=True)
class Candidates:
    """The actions that each agent may take now, each with the present sensors: situations.

    Attributes:
        situations: Shape `(A, C, D)`, in the unit cube.
        rows: Shape `(A, C)`, the leaf that holds each of them.
    """

    situations: Tensor
    rows: Tensor


@dataclass(frozen=True)
class Knowledge:
    """What the robots know when they choose.

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
    """Says what candidates are worth; the agent takes one by that."""

    @property
    def needs(self) -> frozenset[Need]:
        """Which optional parts of the knowledge the drive looks at."""

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`, float64; higher is better.

        The units are the drive's own: those of progress and of errors are scaled.
        """


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
    """The size of the learning progress of the candidate's region, falling or growing errors alike.

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


@dataclass(frozen=True)
class Error:
    """The expected error: go where it is least predictable.

    worth(a) = mean error of the region that holds (a, sensors), or MP(a, sensors)

    Raises:
        ValueError: `source` is neither "region" nor "meta".

    Source: the naive curiosity that the 2004 paper warns of; with "region", MAX in Oudeyer, Kaplan
    and Hafner (2007).
    """

    source: Literal["region", "meta"] = "region"
    """Whose expectation: the mean of the region's last errors (0 without any), or MP's."""

    def __post_init__(self) -> None:
        if self.source not in ("region", "meta"):
            raise ValueError(f"source must be region or meta, got {self.source}")

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

    Source: the naive curiosity that the 2004 paper warns of.
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
class Stage:
    """A part of a curriculum: the values of one dimension that are to be trained, and when.

    Raises:
        ValueError: `low` and `high` are not finite and in order, or `until` is negative or too
            large.
    """

    dimension: str
    """The name of the action that the stage is about."""
    low: float
    """Values lie above this, in raw units."""
    high: float
    """And at this at most."""
    until: int
    """The decision at which the stage ends; the last stage never does."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(
                f"a stage's low and high must be finite and in order, got {self.low} and "
                f"{self.high}"
            )
        check_count("until", self.until, least=0)


FROM_EASY_TO_HARD = (Stage("sound", 2 / 3, 1.0, 1000), Stage("sound", 1 / 3, 2 / 3, 0))
"""The toy room's lesson: f3 for 1,000 decisions, then f2."""


@dataclass(frozen=True)
class Curriculum:
    """A schedule made by hand: passive development.

    worth(a) = 1 if the action is in the present stage, else 0

    Raises:
        ValueError: There are no stages.

    Source: Elman (1993) and Nagai et al. (2002), as the 2004 paper speaks of them.
    """

    needs: ClassVar[frozenset[Need]] = frozenset()

    stages: tuple[Stage, ...] = FROM_EASY_TO_HARD
    """What is trained, in order of time."""

    def __post_init__(self) -> None:
        if not self.stages:
            raise ValueError("stages must hold at least one stage, got none")

    def columns(self, space: SensorimotorSpace) -> list[int]:
        """Return where each stage's action stands among the actions, counted from 0.

        Raises:
            ValueError: The world has no action of a stage's name.
        """
        names = [action.name for action in space.actions]
        for stage in self.stages:
            if stage.dimension not in names:
                raise ValueError(
                    f"a stage must be about an action ({', '.join(names)}), got {stage.dimension}"
                )
        return [names.index(stage.dimension) for stage in self.stages]

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        later = (stage for stage in self.stages[:-1] if knowledge.step < stage.until)
        stage = next(later, self.stages[-1])
        column = self.columns(knowledge.space)[self.stages.index(stage)]
        action = knowledge.space.actions[column]
        values = action.low + candidates.situations[:, :, column] * (action.high - action.low)
        return ((values > stage.low) & (values <= stage.high)).double()


@dataclass(frozen=True)
class Random:
    """The baseline: nothing is worth more than anything else, so actions are uniformly random.

    Source: RANDOM in Oudeyer, Kaplan and Hafner (2007).
    """

    needs: ClassVar[frozenset[Need]] = frozenset()

    def worth(self, candidates: Candidates, knowledge: Knowledge) -> Tensor:
        """Return what each candidate is worth, shape `(A, C)`."""
        return knowledge.history.progress.new_zeros(candidates.rows.shape)


def known(part: Part | None, name: Need) -> Part:
    """Return an optional part of the knowledge.

    Raises:
        RuntimeError: It is not kept, since the drive's `needs` do not name it.
    """
    if part is None:
        raise RuntimeError(f"a drive must name what it looks at in its needs, got none of {name}")
    return part
