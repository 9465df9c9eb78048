"""Do robots develop as the paper says? Many seeds of the main job, on the real world.

    python -m scripts.studies.development

prints, for each seed and in all, where the first cut was, when the robot focused on f3 and on f2,
how much time it spent in f1, and whether MP expected the errors that came. Runs that are in the
folder already are not run again.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from scripts.studies.study import Life, live_all
from torch_iac import IACConfig, MetaPredictor
from torch_iac.runs.reader import Run


@dataclass(frozen=True)
class Study:
    """How many robots develop for how long."""

    seeds: int = 20
    """How many robots, with the seeds 0, 1, ..."""
    steps: int = 10_000
    """How many decisions each takes."""
    out: Path = Path("runs/development")
    """Where the run folders go."""
    processes: int = 2
    """How many robots develop at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print the table."""
    runs = robots_of(study.out, range(study.seeds), study.steps, study.processes)
    robots = [run.summary["agents"][0] for run in runs]
    print("| seed | first cut | focus on f3 | focus on f2 | f1 after 1,000 | f2 after 1,000 |")
    print("|---|---|---|---|---|---|")
    for seed, robot in enumerate(robots):
        cut, focus, shares = robot["first_cut"], robot["focus"], robot["settled_zone_shares"]
        print(
            f"| {seed} | {cut['dimension']} at {cut['value']:.2f} | {focus['f3']} | {focus['f2']} "
            f"| {shares['f1']:.1%} | {shares['f2']:.1%} |"
        )
    on_sound = sum(robot["first_cut"]["dimension"] == "sound" for robot in robots)
    in_order = sum(came_first(robot["focus"]["f3"], robot["focus"]["f2"]) for robot in robots)
    f1 = np.array([robot["settled_zone_shares"]["f1"] for robot in robots])
    print(f"\nFirst cut on the sound: {on_sound} of {study.seeds}.")
    print(f"Focus on f3 before focus on f2: {in_order} of {study.seeds}.")
    print(
        f"Time in f1 after the first 1,000 decisions: mean {f1.mean():.1%}, "
        f"median {np.median(f1):.1%}, range {f1.min():.1%} to {f1.max():.1%}; "
        f"at most 10 % in {(f1 <= 0.1).sum()} of {study.seeds}."
    )
    for zone in ("f1", "f2", "f3"):
        ratios = np.array([run.summary["calibration"]["zones"][zone]["ratio"] for run in runs])
        print(
            f"MP's expectation over the actual error in {zone}: median {np.median(ratios):.2f}, "
            f"range {ratios.min():.2f} to {ratios.max():.2f}; "
            f"within 25 % in {(np.abs(ratios - 1) <= 0.25).sum()} of {study.seeds}."
        )


def robots_of(folder: Path, seeds: range, n_steps: int, processes: int) -> list[Run]:
    """Return the runs of robots with these seeds; those that are not there yet are run."""
    config = IACConfig(meta=MetaPredictor())
    lives = [Life(folder / f"seed-{seed:03d}", config, (seed,), n_steps) for seed in seeds]
    return live_all(lives, processes)


def came_first(first: float | None, second: float | None) -> bool:
    """Return whether both came, the first one before the second."""
    return first is not None and second is not None and first < second


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
