"""Why do some robots predict f2 better than others: what they did, or in which order they did it?

    python -m scripts.studies.coverage

For robots of each drive, those of `scripts.studies.reproduce_paper`: how far the situations that
are asked for lie from what a robot did in f2, in the dimensions that decide what comes of them;
the error if the outcome of the nearest were the prediction; the robots' own error; and that of
robots to which the same decisions were told in another order. Prints Markdown.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from scripts.studies.claims import nearest
from scripts.studies.reproduce_paper import BLOCKS, DRIVES, SETS, VARIANTS, runs_in
from torch_iac import IAC, IACConfig
from torch_iac.analysis.generalisation import Transitions, errors_on, sets_aside
from torch_iac.analysis.intervals import POSITIVE, in_words, mean
from torch_iac.runs.reader import Run

Values = NDArray[np.float64]

SHUFFLE_SEED = 0


@dataclass(frozen=True)
class Study:
    """How many robots are looked at, and where they are."""

    robots: int = 30
    """How many robots of each kind are told their decisions again: the first so many."""
    seeds: int = 100
    """How many robots of each kind there are, with the seeds 0, 1, ..."""
    steps: int = 10_000
    """How many decisions each took."""
    out: Path = Path("runs/paper")
    """Where the run folders are, or go."""
    processes: int = 2
    """How many runs go on at once."""

    def __post_init__(self) -> None:
        most = min(self.seeds, BLOCKS["kinematic"])  # the robots of the first run
        if not 1 <= self.robots <= most:
            raise ValueError(f"robots must lie in [1, {most}], got {self.robots}")


def main(study: Study) -> None:
    """Print a row for each drive."""
    torch.set_num_threads(1)
    kinds = ["knn", *(f"knn-{drive}" for drive in DRIVES)]
    runs = runs_in("kinematic", {kind: VARIANTS[kind] for kind in kinds}, study.seeds, study)
    sets = sets_aside("kinematic", {})
    titles = ["robots"]
    for where in ("contexts met", "anywhere"):
        titles += [f"gaps: {where}", "error of the nearest", "own error", "told in another order"]
    print(f"| {' | '.join(titles)} |\n{'|---' * len(titles)}|")
    for kind, (run, *_) in runs.items():
        print(f"| {kind} | {' | '.join(row(run, sets, study.robots))} |")


def row(run: Run, sets: Mapping[str, Transitions], n_robots: int) -> list[str]:
    """Return what is printed of the first robots of a run."""
    rng = np.random.default_rng(SHUFFLE_SEED)
    shuffled = [rng.permutation(run.n_decisions) for _ in range(n_robots)]
    orders = (
        np.arange(run.n_decisions)[:, None].repeat(n_robots, axis=1),
        np.stack(shuffled, axis=1),
    )
    taken = decisions(run, n_robots)
    agents = [told(run, taken, order) for order in orders]
    cells = []
    for which in SETS:
        distances, errors = (of[:n_robots].mean(axis=1) for of in nearest(run, sets[which]))
        cells += [in_words(mean(distances, POSITIVE)), in_words(mean(errors, POSITIVE))]
        cells += [in_words(mean(errors_on(sets[which], of).absolute, POSITIVE)) for of in agents]
    return cells


def decisions(run: Run, n_robots: int) -> tuple[Values, Values, Values]:
    """Return the first robots' actions, and their sensors before and after, `(T, A, ...)`.

    After an action only what is predicted is recorded, and nothing else is learnt from; the other
    sensors are given as they were before.
    """
    situations = run.columns(run.situation_columns)[:, :n_robots]
    actions, sensors = np.split(situations, [len(run.space.actions)], axis=-1)
    after = sensors.copy()
    names = (f"outcome/{dimension.name}" for dimension in run.space.outcomes)
    after[..., list(run.space.outcome_columns)] = run.columns(names)[:, :n_robots]
    return actions, sensors, after


def told(run: Run, taken: tuple[Values, Values, Values], orders: NDArray[np.int64]) -> IAC:
    """Return new robots to which the decisions of a run were told, in orders `(T, A)`."""
    actions, sensors, after = taken
    robots = np.arange(orders.shape[1])
    agent = IAC(run.space, IACConfig(meta=None), run.seeds[: len(robots)])
    for order in tqdm(orders, unit="decision", disable=None, leave=False):
        agent.set_actions(actions[order, robots], sensors[order, robots])
        agent.observe(after[order, robots])
    return agent


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
