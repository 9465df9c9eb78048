"""Do robots develop in the kinematic room as they do in pybullet's?

    python -m scripts.studies.kinematic_learning

As many robots are in each; prints, for each measure of their development, its mean in both rooms
and the difference of the means, with bootstrap intervals of 95 %. Where the interval of the
difference holds 0, the rooms cannot be told apart by so many robots. Runs that are in the folder
already are not run again.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.stats import bootstrap

import torch_iac as iac
from torch_iac.compare.engine import run_variants

ROOMS = {"pybullet": "toyroom", "kinematic": "kinematic"}
"""The rooms, and what an experiment calls them."""

BLOCK = 10
"""How many robots are one run."""

Robot = dict[str, Any]

MEASURES: dict[str, Callable[[Robot], float | None]] = {
    "share of f1 after 1,000": lambda robot: robot["settled_zone_shares"]["f1"],
    "share of f2 after 1,000": lambda robot: robot["settled_zone_shares"]["f2"],
    "share of f3 after 1,000": lambda robot: robot["settled_zone_shares"]["f3"],
    "decision of the focus on f3": lambda robot: robot["focus"]["f3"],
    "decision of the focus on f2": lambda robot: robot["focus"]["f2"],
    "first cut is on the sound": lambda robot: robot["first_cut"]["dimension"] == "sound",
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
    for name, measure in MEASURES.items():
        one, other = (known(map(measure, robots[room])) for room in ROOMS)
        print(f"| {name} | {interval(one)} | {interval(other)} | {interval(other, one)} |")


def known(values: Any) -> NDArray[np.float64]:
    """Return the values that there are: a robot may never focus."""
    return np.array([value for value in values if value is not None], dtype=np.float64)


def interval(values: NDArray[np.float64], less: NDArray[np.float64] | None = None) -> str:
    """Return a mean, or the difference of two, and its interval."""
    samples = (values,) if less is None else (values, less)
    if not all(map(len, samples)):
        return "none did"
    mean = values.mean() - (0.0 if less is None else less.mean())
    if all(np.ptp(sample) == 0 for sample in samples):
        return f"{mean:.4g}, in all"
    found = bootstrap(samples, difference, vectorized=True, rng=np.random.default_rng(0))
    low, high = found.confidence_interval
    return f"{mean:.3g} ({low:.3g} to {high:.3g})"


def difference(*samples: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
    """Return the mean of the first sample, less that of the second if there is one."""
    means = [np.asarray(sample.mean(axis=axis)) for sample in samples]
    return means[0] - means[1] if len(means) > 1 else means[0]


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
