"""What is there to be curious about in public worlds? Robots with the drive, and random ones.

    python -m scripts.studies.other_worlds

lets robots develop in worlds of Gymnasium. It prints, for actions
held for one step and for ten, how many of the cuts are on an action, for only there can a robot
choose; then what swimmers, and robots in three worlds of other people, spend their time with, and
draws that. Needs the extra `worlds`. Runs that are in the folder already are not run again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from torch_iac import Drive, Experiment, IACConfig, Progress, Random
from torch_iac.analysis.intervals import PART, band
from torch_iac.analysis.style import STYLE, band_style, legend, time_axis, zone_style
from torch_iac.compare.engine import run_variants
from torch_iac.runs.reader import Run

WORLDS = ("Pendulum-v1", "MountainCarContinuous-v0", "Swimmer-v5")
DRIVES: dict[str, Drive] = {"progress": Progress(), "random": Random()}
HOLDS = (1, 10)
STOP = 1.7
"""Radians: a joint of the swimmer that is bent so far is at its stop, which is at 1.745."""
REST = 0.02
"""Metres a second: a ball that is slower in a direction is at rest in it."""
N_PARTS = 4
"""Shares and errors are told for so many equal parts of a run."""
N_POINTS = 40
"""A curve has so many points."""


@dataclass(frozen=True)
class Subject:
    """A world, and the kinds of decisions that robots take there."""

    name: str
    """What it is called in the tables."""
    experiment: Mapping[str, Any]
    """The fields of its experiments."""
    kinds: tuple[str, ...]
    """The kinds of decisions."""
    kind_of: Callable[[Run], NDArray[np.intp]]
    """Returns the kind of each decision, shape `(T, A)`."""


def swimmers_kinds(run: Run) -> NDArray[np.intp]:
    """Return in which posture each swimmer was."""
    at_stop = [np.abs(run.column(f"outcome/sensor_{joint}")) > STOP for joint in (1, 2)]
    return np.asarray(2 - np.sum(at_stop, axis=0))


def balls_kinds(run: Run) -> NDArray[np.intp]:
    """Return in how many directions each ball moved after a push."""
    speeds = [np.abs(run.column(f"outcome/observation/{place}")) for place in (2, 3)]
    return np.asarray(np.sum([speed > REST for speed in speeds], axis=0))


def kinds_of_actions(of_action: Sequence[int]) -> Callable[[Run], NDArray[np.intp]]:
    """Return what tells decisions apart by their action: the kind of each."""

    def kind_of(run: Run) -> NDArray[np.intp]:
        return np.asarray(of_action)[run.column("action/action_0").astype(np.intp)]

    return kind_of


SWIMMER = Subject(
    "swimmer",
    {"world": "Swimmer-v5", "hold": 10},
    ("both joints at a stop", "one joint at a stop", "no joint at a stop"),
    swimmers_kinds,
)
OTHERS = (
    Subject(
        "MiniGrid",
        {"world": "minigrid:MiniGrid-MultiRoom-N2-S4-v0"},
        ("does nothing", "steps or opens", "turns"),
        # Left, right, forward, pick up, drop, toggle, done.
        kinds_of_actions([2, 2, 1, 0, 0, 1, 0]),
    ),
    Subject(
        "FrozenLake",
        {"world": "FrozenLake-v1"},
        ("left", "up", "down or right"),
        kinds_of_actions([0, 2, 2, 1]),  # left, down, right, up
    ),
    Subject(
        "PointMaze",
        {
            "world": "gymnasium_robotics:PointMaze_UMaze-v3",
            "hold": 20,
            "outcomes": tuple(f"observation/{place}" for place in range(4)),
        },
        ("at rest", "moves along an axis", "moves along both"),
        balls_kinds,
    ),
)


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
    others: int = 5
    """How many robots are watched in each of three worlds of other people."""
    other_steps: int = 3_000
    """How many decisions each of them takes."""
    out: Path = Path("runs/other_worlds")
    """Where the run folders go."""
    pictures: Path = Path("docs/images")
    """Where the pictures go."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print the tables and draw the pictures."""
    tell_choices(study)
    (swimmers,) = runs_of(
        study, "swimmers", {"swimmer": SWIMMER.experiment}, study.swimmers, study.swimmer_steps
    )
    fields = {subject.name: subject.experiment for subject in OTHERS}
    others = runs_of(study, "others", fields, study.others, study.other_steps)
    for subject, pair in zip((SWIMMER, *OTHERS), (swimmers, *others), strict=True):
        for drive, run in zip(DRIVES, pair, strict=True):
            tell(subject, drive, run)
    study.pictures.mkdir(parents=True, exist_ok=True)
    draw([SWIMMER], [swimmers], study.pictures / "swimmer.png")
    draw(OTHERS, others, study.pictures / "other_worlds.png")


def tell_choices(study: Study) -> None:
    """Print where the trees let robots choose, and whether they then do otherwise."""
    kinds = [(world, hold) for world in WORLDS for hold in HOLDS]
    fields = {f"{world}-hold-{hold}": {"world": world, "hold": hold} for world, hold in kinds}
    pairs = runs_of(study, "choices", fields, study.robots, study.steps)
    print("| world | held for | cuts on an action | the drive changes what is done by |")
    print("|---|---|---|---|")
    for (world, hold), (curious, random) in zip(kinds, pairs, strict=True):
        n_changed = np.any(actions(curious) != actions(random), axis=(0, 2)).sum()
        changed = f"{n_changed} of {curious.n_agents} robots"
        print(f"| {world} | {hold} | {cuts_on_actions(curious)} | {changed} |")


def runs_of(
    study: Study, folder: str, worlds: Mapping[str, Mapping[str, Any]], n_robots: int, n_steps: int
) -> list[list[Run]]:
    """Return the runs with each drive, in worlds given by the fields of their experiments.

    All robots of a world and a drive are one run; it is run if it is not there yet.
    """
    experiments = {
        f"{name}-{drive}": Experiment(
            **fields, config=IACConfig(drive=DRIVES[drive], meta=None), steps=n_steps
        )
        for name, fields in worlds.items()
        for drive in DRIVES
    }
    runs = run_variants(
        study.out / folder,
        experiments,
        n_seeds=n_robots,
        block=n_robots,
        processes=study.processes,
    )
    return [[runs[f"{name}-{drive}"][0] for drive in DRIVES] for name in worlds]


def actions(run: Run) -> NDArray[Any]:
    """Return what was done, shape `(T, A, actions)`."""
    return run.columns(f"action/{of.name}" for of in run.space.actions)


def cuts_on_actions(run: Run) -> str:
    """Return how many of the cuts of all robots are on an action, and how many there are."""
    cuts = [cut for cut in run.regions["cut_dimension"].to_pylist() if cut is not None]
    return f"{sum(cut.startswith('action_') for cut in cuts)} of {len(cuts)}"


def shares(subject: Subject, run: Run, n_parts: int) -> NDArray[np.float64]:
    """Return the share of each kind in equal parts of a run, shape `(parts, A, kinds)`."""
    parts = np.array_split(subject.kind_of(run), n_parts)
    return np.stack(
        [[(part == kind).mean(axis=0) for kind in range(len(subject.kinds))] for part in parts]
    ).transpose(0, 2, 1)


def tell(subject: Subject, drive: str, run: Run) -> None:
    """Print the share of each kind, part by part, and how well it is predicted."""
    of_parts, errors, kinds = (
        shares(subject, run, N_PARTS),
        run.column("error"),
        subject.kind_of(run),
    )
    heads = " | ".join(f"part {i + 1}" for i in range(N_PARTS))
    print(f"\n| {subject.name}, {drive} | {heads} | error |")
    print("|---" * (N_PARTS + 2) + "|")
    for place, kind in enumerate(subject.kinds):
        cells = [
            f"{robots.mean():.0%} ({robots.min():.0%} to {robots.max():.0%})"
            for robots in of_parts[:, :, place]
        ]
        print(f"| {kind} | {' | '.join(cells)} | {errors[kinds == place].mean():.4f} |")
    first, second = shares(subject, run, 2)[:, :, 0]
    n_more = int((first > second).sum())
    print(f"\nMore of {subject.kinds[0]} in the first half: {n_more} of {run.n_agents} robots.")


def draw(subjects: Sequence[Subject], pairs: Sequence[Sequence[Run]], picture: Path) -> None:
    """Draw the share of each kind over time, for each drive; bands are 95 % intervals.

    Each world is a row of panels, which has a key of its own.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 2.7 * len(subjects)), layout="constrained")
        rows = figure.subfigures(len(subjects), 1, squeeze=False)[:, 0]
        for row, subject, pair in zip(rows, subjects, pairs, strict=True):
            panels = row.subplots(1, len(pair), sharey=True)
            for panel, run, drive in zip(panels, pair, DRIVES, strict=True):
                draw_shares(panel, subject, run)
                name = "" if len(subjects) == 1 else f"{subject.name}, "
                panel.set_title(f"{name}drive {drive}", fontsize=8)
            panels[0].set_ylim(0, 1)
            panels[0].yaxis.set_major_formatter(PercentFormatter(1.0))
            panels[0].set_ylabel("Share of time")
            legend(row, panels[0].get_legend_handles_labels()[0], n_columns=3)
        figure.savefig(picture, dpi=200)


def draw_shares(panel: Axes, subject: Subject, run: Run) -> None:
    """Draw the share of each kind over time in one panel."""
    time_axis(panel, run.n_decisions)
    of_parts = shares(subject, run, N_POINTS)
    middles = (np.arange(N_POINTS) + 0.5) * run.n_decisions / N_POINTS
    for place, kind in enumerate(subject.kinds):
        robots, style = of_parts[:, :, place], zone_style(place)
        panel.plot(middles, robots.mean(axis=1), label=kind, **style)
        panel.fill_between(middles, *band(robots, PART), **band_style(style["color"]))


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
