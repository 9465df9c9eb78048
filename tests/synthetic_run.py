"""A made-up run with the plot of the paper's: f3 is learnt first, then f2, and f1 never is.

No engine is needed: full regions are cut along the sound as long as they hear several zones and
along the left wheel after that; errors follow a formula.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torch_iac.config import IACConfig
from torch_iac.meta_predictor import MetaPredictor
from torch_iac.records import Genealogy, RegionSummary, ShadowStep, Step
from torch_iac.runs.recorder import Recorder
from torch_iac.space import Dimension, SensorimotorSpace

ZONES = ("f1", "f2", "f3")
TOY_DISTANCE = Dimension("toy_distance", 0.0, 5.0)
SPACE = SensorimotorSpace(
    actions=(Dimension("left_wheel", -1.0, 1.0), Dimension("sound", 0.0, 1.0)),
    sensors=(Dimension("beam", 0.0, 4.0), TOY_DISTANCE),
    outcomes=(TOY_DISTANCE,),
)
LEFT_WHEEL, SOUND = 0, 1
SOUND_CUTS = (2 / 3, 1 / 3)
FULL = 250
GENEALOGY = (
    "parent",
    "depth",
    "born_step",
    "split_step",
    "cut_dimension",
    "cut_value",
    "n_examples",
)
SUMMARY = ("progress", "mean_error", "n_examples")


def write_run(
    folder: Path,
    n_agents: int = 1,
    n_decisions: int = 1500,
    zone_names: tuple[str, ...] | None = ZONES,
    rows_per_part: int = 1000,
    log_every: int = 100,
    numbers: Mapping[str, Any] | None = None,
    shadows: Mapping[str, float] | None = None,
    meta: bool = False,
    n_recorded: int | None = None,
) -> Path:
    """Record a made-up run and return its folder; its shadows as `SyntheticPopulation` has them."""
    population = SyntheticPopulation(n_agents, n_decisions, shadows, meta, **(numbers or {}))
    with Recorder(
        folder,
        population,
        zone_names,
        log_every=log_every,
        rows_per_part=rows_per_part,
        n_recorded=n_recorded,
    ) as recorder:
        for _ in range(n_decisions):
            step, zones = population.decide()
            recorder.record(step, None if zone_names is None else zones)
    return folder


@dataclass
class Region:
    """A region; bounds and cut in the unit cube."""

    parent: int
    depth: int
    born_step: int
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    errors: list[float]
    n_examples: int
    split_step: int = -1
    cut_dimension: int = -1
    cut_value: float = float("nan")
    children: tuple[int, ...] = ()

    @property
    def progress(self) -> float:
        errors = self.errors
        return float(np.mean(errors[-300:-150]) - np.mean(errors[-150:])) if errors[299:] else 0.0

    @property
    def mean_error(self) -> float:
        return float(np.mean(self.errors[-150:])) if self.errors else float("nan")


@dataclass
class Robot:
    """One agent: its tree, and how often it was in each zone."""

    rng: np.random.Generator
    regions: list[Region] = field(
        default_factory=lambda: [Region(-1, 0, 0, np.zeros(4), np.ones(4), [], 0)]
    )
    practice: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))

    def choose(self, life: float) -> tuple[NDArray[np.float64], int, bool]:
        """Return a situation, its zone and whether it is random; `life` goes from 0 to 1."""
        situation = self.rng.random(4)
        random = bool(self.rng.random() < 0.1)
        if life > 0.15 and not random:
            favourite = 2 if life < 0.4 + 0.1 * self.rng.standard_normal() else 1
            situation[SOUND] = (favourite + situation[SOUND]) / 3
        return situation, min(2, int(situation[SOUND] * 3)), random

    def error(self, zone: int) -> tuple[float, float]:
        """Return how far off the prediction is and would be on average.

        Practice helps in f2, and quickly in f3.
        """
        self.practice[zone] += 1
        scale = (0.3, 0.02 + 0.2 * np.exp(-self.practice[1] / 400), 0.01)[zone]
        if zone == 2:
            scale += 0.4 * np.exp(-self.practice[2] / 60)
        mean = float(scale * np.sqrt(2 / np.pi))
        return float(scale * abs(self.rng.standard_normal())), mean

    def route(self, situation: NDArray[np.float64]) -> int:
        number = 0
        while (region := self.regions[number]).children:
            number = region.children[int(situation[region.cut_dimension] > region.cut_value)]
        return number

    def learn(self, number: int, error: float, step: int) -> None:
        region = self.regions[number]
        region.errors.append(error)
        region.n_examples += 1
        if region.n_examples > FULL:
            self.split(number, step)

    def split(self, number: int, step: int) -> None:
        region = self.regions[number]
        low, high = region.lows[SOUND], region.highs[SOUND]
        cuts = [cut for cut in SOUND_CUTS if low < cut < high]
        region.cut_dimension = SOUND if cuts else LEFT_WHEEL
        wheel = (region.lows[LEFT_WHEEL] + region.highs[LEFT_WHEEL]) / 2
        region.cut_value = cuts[0] if cuts else float(wheel)
        region.split_step = step
        region.children = (len(self.regions), len(self.regions) + 1)
        for side in (0, 1):
            lows, highs = region.lows.copy(), region.highs.copy()
            (highs, lows)[side][region.cut_dimension] = region.cut_value
            errors, half = region.errors[-300:], region.n_examples // 2
            depth = region.depth + 1
            self.regions.append(Region(number, depth, step, lows, highs, errors, half))


class SyntheticPopulation:
    """Some robots; what a recorder asks of an agent, and decisions to record.

    Args:
        n_agents: How many robots.
        n_decisions: How long they live.
        shadows: How many times the error of the experts that of each shadow is.
        meta: Whether there is an MP; it expects the very mean of the errors.
        numbers: What their config says; they do not heed it.
    """

    def __init__(
        self,
        n_agents: int,
        n_decisions: int,
        shadows: Mapping[str, float] | None = None,
        meta: bool = False,
        **numbers: Any,
    ) -> None:
        self.space = SPACE
        self.config = IACConfig(meta=MetaPredictor() if meta else None, **numbers)
        self.seeds = tuple(range(100, 100 + n_agents))
        self.n_decisions = n_decisions
        self.shadows = dict(shadows or {})
        self.meta = meta
        self.robots = [Robot(np.random.default_rng(seed)) for seed in self.seeds]
        self.number = 0

    def decide(self) -> tuple[Step, NDArray[np.int64]]:
        """Return the next decision of every robot, and the zones they were in."""
        chosen = [robot.choose(self.number / self.n_decisions) for robot in self.robots]
        zones = np.array([zone for _, zone, _ in chosen])
        numbers = [r.route(s) for r, (s, _, _) in zip(self.robots, chosen, strict=True)]
        progress = [r.regions[n].progress for r, n in zip(self.robots, numbers, strict=True)]
        drawn = [r.error(zone) for r, zone in zip(self.robots, zones, strict=True)]
        errors, expected = [error for error, _ in drawn], [mean for _, mean in drawn]
        for robot, number, error in zip(self.robots, numbers, errors, strict=True):
            robot.learn(number, error, self.number)
        step = self._step(np.array([situation for situation, _, _ in chosen]), errors)
        step = Step(
            **vars(step)
            | {
                "expected_errors": torch.tensor(expected) if self.meta else None,
                "regions": torch.tensor(numbers),
                "progress": torch.tensor(progress, dtype=torch.float64),
                "random_actions": torch.tensor([random for _, _, random in chosen]),
            }
        )
        self.number += 1
        return step, zones

    def _step(self, situations: NDArray[np.float64], errors: list[float]) -> Step:
        raw = torch.tensor(situations * [2, 1, 4, 5] - [1, 0, 0, 0], dtype=torch.float32)
        error = torch.tensor(errors, dtype=torch.float64)
        none = torch.zeros(len(errors))
        outcomes = raw[:, 3:].clone()

        def predictions(error: Tensor) -> Tensor:
            return (outcomes + 5 * error[:, None]).float()

        return Step(
            self.number,
            raw[:, :2],
            raw[:, 2:],
            outcomes,
            predictions(error),
            error,
            None,
            none,
            none,
            none,
            tuple(
                ShadowStep(name, predictions(times * error), times * error)
                for name, times in self.shadows.items()
            ),
        )

    def genealogy(self) -> Genealogy:
        rows = [
            (agent, number, *attrgetter(*GENEALOGY)(r))
            for agent, robot in enumerate(self.robots)
            for number, r in enumerate(robot.regions)
        ]
        columns = [torch.tensor(column) for column in zip(*rows, strict=True)]
        return Genealogy(*columns)

    def region_summary(self, n_agents: int | None = None) -> RegionSummary:
        leaves = [
            (agent, number, *attrgetter(*SUMMARY)(r))
            for agent, robot in enumerate(self.robots[:n_agents])
            for number, r in enumerate(robot.regions)
            if not r.children
        ]
        return RegionSummary(*(torch.tensor(np.array(c)) for c in zip(*leaves, strict=True)))
