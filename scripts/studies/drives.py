"""What does each drive make of the toy room? Every drive, some seeds, paired by seed.

    python -m scripts.studies.drives

prints, for each drive, the share of time in each zone over the first 1,000 decisions, over the last
5,000, and when the robot first focused on f3 and on f2. Networks as experts are there too.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

import torch_iac as iac
from torch_iac.compare.engine import run_variants
from torch_iac.runs.reader import Run
from torch_iac.runs.statistics import focus_steps
from torch_iac.toy_room import FOCUS_SHARES

MP = iac.MetaPredictor()
IMPROVEMENT = iac.ImprovementPredictor()
NETWORKS = iac.MLPExperts()

VARIANTS: dict[str, dict[str, Any]] = {
    "progress": {},
    "progress, networks": {"experts": NETWORKS},
    "meta_progress": {"drive": iac.MetaProgress(), "meta": MP},
    "absolute_progress": {"drive": iac.AbsoluteProgress()},
    "absolute_progress, proportional": {
        "drive": iac.AbsoluteProgress(),
        "choice": iac.Proportional(),
    },
    "global_progress": {"drive": iac.GlobalProgress(), "meta": MP},
    "error (region)": {"drive": iac.Error()},
    "error (MP)": {"drive": iac.Error(source="meta"), "meta": MP},
    "novelty": {"drive": iac.Novelty()},
    "improvement": {"drive": iac.Improvement(), "improvement": IMPROVEMENT},
    "improvement, networks": {
        "experts": NETWORKS,
        "drive": iac.Improvement(),
        "improvement": IMPROVEMENT,
    },
    "curriculum": {"drive": iac.Curriculum()},
    "random": {"drive": iac.Random()},
}
"""In which numbers robots differ from the paper's without MP, by row of the table."""


@dataclass(frozen=True)
class Study:
    """How many robots each drive gets, and for how long."""

    seeds: int = 5
    """How many robots a drive, with the seeds 0, 1, ..."""
    steps: int = 10_000
    """How many decisions each takes."""
    only: tuple[str, ...] = ()
    """Only these rows of the table; all by default."""
    out: Path = Path("runs/drives")
    """Where the run folders go."""
    processes: int = 2
    """How many robots develop at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print the table."""
    titles = {folder_name(title): title for title in study.only or VARIANTS}
    experiments = {
        name: iac.Experiment(
            config=iac.IACConfig(**{"meta": None, **VARIANTS[title]}), steps=study.steps
        )
        for name, title in titles.items()
    }
    runs = run_variants(study.out, experiments, n_seeds=study.seeds, processes=study.processes)
    late = study.steps // 2
    print(
        f"| drive | first 1,000: f1, f2, f3 | last {late:,}: f1, f2, f3 (range of f1) "
        "| focus on f3 | focus on f2 |\n|---|---|---|---|---|"
    )
    for name, robots in runs.items():
        first = np.array([shares(run)[0] for run in robots])
        last = np.array([shares(run, late)[1] for run in robots])
        print(
            f"| {titles[name]} | {percents(first)} | {percents(last)} "
            f"({last[:, 0].min():.0%} to {last[:, 0].max():.0%}) "
            f"| {focus(robots, 'f3')} | {focus(robots, 'f2')} |"
        )


def folder_name(title: str) -> str:
    """Return what a row of the table is called as a folder."""
    return "-".join(re.findall(r"\w+", title))


def shares(run: Run, late: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of the zones over the first 1,000 and the last `late` decisions."""
    zones = run.column("zone")[:, 0]
    first, last = (
        np.bincount(part, minlength=3) / len(part) for part in (zones[:1000], zones[-late:])
    )
    return first, last


def percents(of_robots: np.ndarray) -> str:
    """Return the mean over robots of each zone's share."""
    return ", ".join(f"{share:.0%}" for share in of_robots.mean(axis=0))


def focus(robots: list[Run], zone: str) -> str:
    """Return the median decision at which robots focused on a zone, and how many did."""
    steps = np.array([focus_steps(run, zone, FOCUS_SHARES[zone])[0] for run in robots], float)
    reached = steps[np.isfinite(steps)]
    if not len(reached):
        return "never"
    return f"{np.median(reached):,.0f} ({len(reached)} of {len(robots)})"


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
