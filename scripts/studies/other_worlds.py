"""What is there to be curious about in public worlds? Robots with the drive, and random ones.

    python -m scripts.studies.other_worlds

lets robots develop in worlds of Gymnasium. It prints, for actions
held for one step and for ten, how many of the cuts are on an action, for only there can a robot
choose; then in which posture swimmers spend their time, and draws that. Needs the extra `mujoco`.
Runs that are in the folder already are not run again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tyro
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from torch_iac import Drive, Experiment, IACConfig, Progress, Random
from torch_iac.analysis.intervals import PART, band
from torch_iac.analysis.style import STYLE, ZONE_COLOURS, legend, time_axis
from torch_iac.compare.engine import run_variants
from torch_iac.runs.reader import Run

WORLDS = ("Pendulum-v1", "MountainCarContinuous-v0", "Swimmer-v5")
DRIVES: dict[str, Drive] = {"progress": Progress(), "random": Random()}
SWIMMER, HOLDS = WORLDS[-1], (1, 10)
STOP = 1.7
"""Radians: a joint of the swimmer that is bent so far is at its stop, which is at 1.745."""
POSTURES = ("both joints at a stop", "one joint at a stop", "no joint at a stop")
N_PARTS = 4
"""Shares and errors are told for so many equal parts of a run."""
N_POINTS = 40
"""A curve has so many points."""


@dataclass(frozen=True)
class Study:
    """How many robots develop for how long; they have the seeds 0, 1, ..."""

    robots: int = 5
    """How many in each world."""
    steps: int = 3_000
    """How many decisions each takes."""
    swimmers: int = 10
    """How many swimmers are watched for longer."""
    swimmer_steps: int = 10_000
    """How many decisions each of them takes."""
    out: Path = Path("runs/other_worlds")
    """Where the run folders go."""
    picture: Path = Path("docs/images/swimmer.png")
    """Where the picture goes."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print the tables and draw the picture."""
    tell_choices(study)
    swimmers = runs_of(
        study, "swimmers", [(SWIMMER, HOLDS[-1])], study.swimmers, study.swimmer_steps
    )[0]
    for name, run in zip(DRIVES, swimmers, strict=True):
        tell_postures(name, run)
    draw(swimmers, study.picture)


def tell_choices(study: Study) -> None:
    """Print where the trees let robots choose, and whether they then do otherwise."""
    kinds = [(world, hold) for world in WORLDS for hold in HOLDS]
    pairs = runs_of(study, "choices", kinds, study.robots, study.steps)
    print("| world | held for | cuts on an action | the drive changes what is done by |")
    print("|---|---|---|---|")
    for (world, hold), (curious, random) in zip(kinds, pairs, strict=True):
        n_changed = np.any(actions(curious) != actions(random), axis=(0, 2)).sum()
        changed = f"{n_changed} of {curious.n_agents} robots"
        print(f"| {world} | {hold} | {cuts_on_actions(curious)} | {changed} |")


def runs_of(
    study: Study, folder: str, kinds: Sequence[tuple[str, int]], n_robots: int, n_steps: int
) -> list[list[Run]]:
    """Return the runs with each drive, in worlds in which an action is held for some steps.

    All robots of a world and a drive are one run; it is run if it is not there yet.
    """
    experiments = {
        f"{world}-hold-{hold}-{name}": Experiment(
            world=world, hold=hold, config=IACConfig(drive=drive, meta=None), steps=n_steps
        )
        for world, hold in kinds
        for name, drive in DRIVES.items()
    }
    runs = run_variants(
        study.out / folder,
        experiments,
        n_seeds=n_robots,
        block=n_robots,
        processes=study.processes,
    )
    return [[runs[f"{world}-hold-{hold}-{name}"][0] for name in DRIVES] for world, hold in kinds]


def actions(run: Run) -> NDArray[Any]:
    """Return what was done, shape `(T, A, actions)`."""
    return run.columns(f"action/{of.name}" for of in run.space.actions)


def cuts_on_actions(run: Run) -> str:
    """Return how many of the cuts of all robots are on an action, and how many there are."""
    cuts = [cut for cut in run.regions["cut_dimension"].to_pylist() if cut is not None]
    return f"{sum(cut.startswith('action_') for cut in cuts)} of {len(cuts)}"


def postures(run: Run) -> NDArray[np.intp]:
    """Return which of the postures each swimmer was in, shape `(T, A)`."""
    at_stop = [np.abs(run.column(f"outcome/sensor_{joint}")) > STOP for joint in (1, 2)]
    return np.asarray(2 - np.sum(at_stop, axis=0))


def shares(run: Run, n_parts: int) -> NDArray[np.float64]:
    """Return the share of each posture in equal parts of a run, shape `(parts, A, postures)`."""
    parts = np.array_split(postures(run), n_parts)
    return np.stack(
        [[(part == p).mean(axis=0) for p in range(len(POSTURES))] for part in parts]
    ).transpose(0, 2, 1)


def tell_postures(name: str, run: Run) -> None:
    """Print the share of each posture, part by part, and how well it is predicted."""
    of_parts, errors, where = shares(run, N_PARTS), run.column("error"), postures(run)
    print(f"\n| {name} | {' | '.join(f'part {i + 1}' for i in range(N_PARTS))} | error |")
    print("|---" * (N_PARTS + 2) + "|")
    for place, posture in enumerate(POSTURES):
        cells = [
            f"{robots.mean():.0%} ({robots.min():.0%} to {robots.max():.0%})"
            for robots in of_parts[:, :, place]
        ]
        print(f"| {posture} | {' | '.join(cells)} | {errors[where == place].mean():.4f} |")
    first, second = shares(run, 2)[:, :, 0]
    n_folded_first = int((first > second).sum())
    print(f"\nBoth at a stop more in the first half: {n_folded_first} of {run.n_agents} robots.")


def draw(runs: Sequence[Run], picture: Path) -> None:
    """Draw the share of each posture over time, for each drive; bands are 95 % intervals."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 2.7), layout="constrained")
        panels = figure.subplots(1, len(runs), sharey=True)
        for panel, run, drive in zip(panels, runs, DRIVES, strict=True):
            time_axis(panel, run.n_decisions)
            of_parts = shares(run, N_POINTS)
            middles = (np.arange(N_POINTS) + 0.5) * run.n_decisions / N_POINTS
            for place, posture in enumerate(POSTURES):
                colour, robots = ZONE_COLOURS[place], of_parts[:, :, place]
                panel.plot(middles, robots.mean(axis=1), color=colour, label=posture)
                panel.fill_between(
                    middles, *band(robots, PART), color=colour, alpha=0.25, linewidth=0
                )
            panel.set_title(f"drive {drive}", fontsize=8)
        panels[0].set_ylim(0, 1)
        panels[0].yaxis.set_major_formatter(PercentFormatter(1.0))
        panels[0].set_ylabel("Share of time")
        legend(figure, panels[0].get_legend_handles_labels()[0], n_columns=3)
        picture.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(picture, dpi=200)


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
