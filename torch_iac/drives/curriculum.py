"""Passive development: a schedule of actions that is made by hand."""

import math
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torch_iac.drives.protocol import Candidates, Knowledge, Need
from torch_iac.internal.validation import check_count, settle
from torch_iac.space import SensorimotorSpace


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
        settle(self)
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(
                f"a stage's low and high must be finite and in order, got {self.low} and "
                f"{self.high}"
            )
        check_count("until", self.until, least=0)


FROM_EASY_TO_HARD = (Stage("sound", 2 / 3, 1.0, 1000), Stage("sound", 1 / 3, 2 / 3, 0))
"""The schedule for the toy room: f3 for 1,000 decisions, then f2."""


@dataclass(frozen=True)
class Curriculum:
    """A schedule of actions made by hand.

    worth(a) = 1 if the action is in the present stage, else 0

    Raises:
        ValueError: There are no stages.

    Source: Elman (1993) and Nagai et al. (2002), as the 2004 paper describes them.
    """

    needs: ClassVar[frozenset[Need]] = frozenset()

    stages: tuple[Stage, ...] = FROM_EASY_TO_HARD
    """What is trained, in order of time."""

    def __post_init__(self) -> None:
        settle(self)
        if not self.stages:
            raise ValueError("stages must hold at least one stage, got none")

    def columns(self, space: SensorimotorSpace) -> list[int]:
        """Return the index of each stage's action among the actions.

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
