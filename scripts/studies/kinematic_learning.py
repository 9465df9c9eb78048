"""Do robots develop in the kinematic room as they do in pybullet's?

    python -m scripts.studies.kinematic_learning

Robots with the same seeds are in each; prints, for each measure of their development, its mean in
both rooms and the mean difference of the pairs, with intervals of 95 %. Where the interval of the
difference holds 0, the rooms cannot be told apart by so many robots. Runs that are in the folder
already are not run again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

import torch_iac as iac
from torch_iac.analysis.intervals import PART, POSITIVE, Estimate, difference, in_words, mean, share
from torch_iac.compare.engine import run_variants

ROOMS = {"pybullet": "toyroom", "kinematic": "kinematic"}
"""The rooms, and what an experiment calls them."""

BLOCK = 10
"""How many robots are one run."""

Robot = dict[str, Any]
Values = NDArray[np.float64]


def part(values: Values) -> Estimate:
    """Return the mean of parts of a whole."""
    return mean(values, PART)


def decision(values: Values) -> Estimate:
    """Return the mean of decisions at which something happened."""
    return mean(values, POSITIVE)


def robots_that_did(values: Values) -> Estimate:
    """Return the share of robots with a 1, not a 0."""
    return share(values == 1)


MEASURES: dict[str, tuple[Callable[[Robot], float | None], Callable[[Values], Estimate]]] = {
    "share of f1 after 1,000": (lambda robot: robot["settled_zone_shares"]["f1"], part),
    "share of f2 after 1,000": (lambda robot: robot["settled_zone_shares"]["f2"], part),
    "share of f3 after 1,000": (lambda robot: robot["settled_zone_shares"]["f3"], part),
    "decision of the focus on f3": (lambda robot: robot["focus"]["f3"], decision),
    "decision of the focus on f2": (lambda robot: robot["focus"]["f2"], decision),
    "first cut is on the sound": (
        lambda robot: robot["first_cut"]["dimension"] == "sound",
        robots_that_did,
    ),
}


@dataclass(frozen=True)
class Study:
    """How many robots develop for how long in each room."""

    seeds: int = 20
    """How many robots, with seeds in succession."""
    first_seed: int = 0
    """The first of the seeds."""
    steps: int = 10_000
    """How many decisions each takes."""
    out: Path = Path("runs/rooms")
    """Where the run folders go."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print the table."""
    runs = run_variants(
        study.out,
        {room: iac.Experiment(world=world, steps=study.steps) for room, world in ROOMS.items()},
        n_seeds=study.seeds,
        seed=study.first_seed,
        block=BLOCK,
        processes=study.processes,
    )
    robots = {
        room: [robot for run in of for robot in run.summary["agents"]] for room, of in runs.items()
    }
    print(f"| {study.seeds} robots each | {' | '.join(ROOMS)} | difference |\n|---|---|---|---|")
    for name, (measure, estimate) in MEASURES.items():
        values = [values_of(robots[room], measure) for room in ROOMS]
        both = np.isfinite(values).all(axis=0)  # a robot may never focus
        cells = [in_words(estimate(of[np.isfinite(of)])) for of in values]
        cells.append(in_words(difference(values[1][both], values[0][both])))
        print(f"| {name} | {' | '.join(cells)} |")


def values_of(robots: Sequence[Robot], measure: Callable[[Robot], float | None]) -> Values:
    """Return a measure of each robot; NaN where there is none."""
    return np.array([measure(robot) for robot in robots], dtype=np.float64)


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
