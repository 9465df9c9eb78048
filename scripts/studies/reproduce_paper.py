"""Does the system do what its papers say? Claim by claim, over many robots.

    python -m scripts.studies.reproduce_paper

lets robots develop in the kinematic room and in pybullet's, with nearest neighbours and networks
and the drives of the papers, then prints what `scripts.studies.claims` makes of them, as Markdown,
and draws the generalisation tests. Runs that are in the folder already are not run again;
`docs/results.md` holds a copy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

import torch_iac as iac
from scripts.studies.claims import (
    CLAIMS,
    F1,
    LATE,
    Claim,
    Group,
    catching_up,
    gaps,
    last_error,
    ratio,
    time_in,
)
from torch_iac.analysis.generalisation import F2, sets_aside, tests_of
from torch_iac.analysis.intervals import PART, POSITIVE, band, in_words, mean
from torch_iac.analysis.style import STYLE, band_style, legend, line_style, save, time_axis
from torch_iac.compare.engine import run_variants
from torch_iac.runs.reader import Run

TEST_EVERY = 100  # decisions, as in 2007

MP = iac.MetaPredictor()
NETWORKS: dict[str, Any] = {"experts": iac.MLPExperts()}
EVENLY: dict[str, Any] = {"drive": iac.AbsoluteProgress(), "choice": iac.Proportional()}


def robots(**numbers: Any) -> iac.Experiment:
    """Return robots of the kinematic room with the paper's numbers but these, and without MP."""
    config = iac.IACConfig(**{"meta": None, **numbers})
    return iac.Experiment(world="kinematic", config=config, test_every=TEST_EVERY)


def robots_of_2007(drive: iac.Drive, meta: iac.MetaPredictor | None = None) -> iac.Experiment:
    """Return robots with that paper's numbers and senses."""
    config = replace(iac.PRESETS["iac2007"], drive=drive, meta=meta)
    options = {"beams": 0, "toy_direction": False}
    return replace(robots(), config=config, world_options=options)


VARIANTS = {
    "knn": robots(),
    "knn-random": robots(drive=iac.Random()),
    "knn-max": robots(drive=iac.Error()),
    "knn-global": robots(drive=iac.GlobalProgress(), meta=MP),
    "knn-proportional": robots(**EVENLY),
    "knn-curriculum": robots(drive=iac.Curriculum()),
    "mlp": robots(**NETWORKS),
    "mlp-random": robots(**NETWORKS, drive=iac.Random()),
    "mlp-max": robots(**NETWORKS, drive=iac.Error()),
    "mlp-global": robots(**NETWORKS, drive=iac.GlobalProgress(), meta=MP),
    "mlp-proportional": robots(**NETWORKS, **EVENLY),
    "mlp-curriculum": robots(**NETWORKS, drive=iac.Curriculum()),
    "2007": robots_of_2007(iac.Progress()),
    "2007-random": robots_of_2007(iac.Random()),
    "2007-max": robots_of_2007(iac.Error()),
    "2007-global": robots_of_2007(iac.GlobalProgress(), MP),
}
"""What is run in the kinematic room."""

IN_PYBULLET = [
    kind + drive for kind in ("knn", "mlp") for drive in ("", "-random", "-max", "-global")
]
"""What is run in pybullet's room as well."""

BLOCKS = {"kinematic": 50, "toyroom": 15}
"""How many robots of each room are one run."""

COLUMNS = {
    "nearest neighbours": ("kinematic", "knn"),
    "in pybullet": ("toyroom", "knn"),
    "networks": ("kinematic", "mlp"),
    "networks in pybullet": ("toyroom", "mlp"),
    "numbers and senses of 2007": ("kinematic", "2007"),
}
"""The columns of the table of claims: a world, and the name of the robots there."""

DRIVES = ("random", "max", "global", "proportional", "curriculum")

LABELS = {
    "iac": "IAC",
    "random": "RANDOM",
    "max": "MAX",
    "curriculum": "a curriculum by hand",
    "proportional": "in proportion to absolute progress",
}
"""What is drawn, under which name."""

ERROR_TICKS = (0.02, 0.03, 0.05, 0.1, 0.2)

SETS = {"met": "Contexts met under random actions", "anywhere": "Poses drawn over the room"}


@dataclass(frozen=True)
class Study:
    """How many robots, and for how long."""

    kinematic_seeds: int = 100
    """How many robots of each kind are in the kinematic room, with the seeds 0, 1, ..."""
    pybullet_seeds: int = 30
    """How many in pybullet's."""
    steps: int = 10_000
    """How many decisions each takes."""
    out: Path = Path("runs/paper")
    """Where the run folders go."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print the claims and the conditions, and draw."""
    runs = runs_of(study)
    print_claims(runs)
    print_conditions(runs["kinematic"])
    figure = draw_tests({kind: group(runs["kinematic"], kind) for kind in ("knn", "mlp")})
    save(figure, study.out / "generalisation.png")
    print(f"\nDrawn: {study.out / 'generalisation.png'}")


def runs_of(study: Study) -> dict[str, dict[str, list[Run]]]:
    """Return the runs of each variant in each world; those that are not there yet are run."""
    physical = {name: VARIANTS[name] for name in IN_PYBULLET}
    return {
        "kinematic": runs_in("kinematic", VARIANTS, study.kinematic_seeds, study),
        "toyroom": runs_in("toyroom", physical, study.pybullet_seeds, study),
    }


class Numbers(Protocol):
    """What all studies that share these runs are told."""

    @property
    def steps(self) -> int:
        """How many decisions each robot takes."""

    @property
    def out(self) -> Path:
        """Where the runs of all worlds are."""

    @property
    def processes(self) -> int:
        """How many runs go on at once."""


def runs_in(
    world: str, experiments: Mapping[str, iac.Experiment], n_seeds: int, numbers: Numbers
) -> dict[str, list[Run]]:
    """Return runs in a world, by name; those that are not there yet are run."""
    return run_variants(
        numbers.out / world,
        {name: replace(of, world=world, steps=numbers.steps) for name, of in experiments.items()},
        n_seeds=n_seeds,
        block=BLOCKS[world],
        processes=numbers.processes,
    )


def group(runs: Mapping[str, Sequence[Run]], kind: str) -> Group:
    """Return the robots of one kind, by drive, as far as there are any."""
    found = {"iac": runs[kind]}
    return found | {d: runs[f"{kind}-{d}"] for d in DRIVES if f"{kind}-{d}" in runs}


def print_claims(runs: Mapping[str, Mapping[str, Sequence[Run]]]) -> None:
    """Print what becomes of each claim, in each column."""
    columns = {title: group(runs[world], kind) for title, (world, kind) in COLUMNS.items()}
    print("| | paper | claim | measured | reproduced, partly |\n|---|---|---|---|---|")
    for number, claim in enumerate(CLAIMS, 1):
        print(f"| {number} | {claim.paper} | {claim.says} | {claim.measured} | {claim.bars} |")
    titles = [f"{t} ({sum(r.n_agents for r in of['iac'])})" for t, of in columns.items()]
    print(f"\n| | {' | '.join(titles)} |")
    print("|---" * (1 + len(titles)) + "|")
    for number, claim in enumerate(CLAIMS, 1):
        cells = [_cell(claim, robots) for robots in columns.values()]
        print(f"| {number} | {' | '.join(cells)} |")


def _cell(claim: Claim, robots: Group) -> str:
    if any(name not in robots for name in claim.needs):
        return ""
    found = claim.number(robots)
    return f"**{claim.verdict(found)}** {in_words(found, percent=claim.is_part)}"


def print_conditions(runs: Mapping[str, Sequence[Run]]) -> None:
    """Print how every kind of robot does on the tests, beside RANDOM of its own kind."""
    titles = ["robots", "time in f1", "in f2", "gaps in f2"]
    titles += [
        title
        for where in ("contexts met", "anywhere")
        for title in (f"error, {where}", "of RANDOM's", "RANDOM's last error at")
    ]
    print(f"\n| {' | '.join(titles)} |")
    print("|---" * len(titles) + "|")
    for name, mine in runs.items():
        others = runs[f"{name.partition('-')[0]}-random"]
        cells = [in_words(mean(time_in(mine, zone, LATE), PART), percent=True) for zone in (F1, F2)]
        sets = sets_aside("kinematic", VARIANTS[name].world_options)
        cells.append(in_words(mean(gaps(mine, sets["met"]), POSITIVE)))
        for which in SETS:
            errors, theirs = (last_error(of, which, "absolute") for of in (mine, others))
            cells += [in_words(mean(errors, POSITIVE)), in_words(ratio(errors, theirs))]
            cells.append(when_reached(catching_up(mine, others, which)))
        print(f"| {name} | {' | '.join(cells)} |")


def when_reached(steps: np.ndarray) -> str:
    """Return the median of when robots came somewhere, those that never did being the last."""
    median = np.median(np.nan_to_num(steps, nan=np.inf))
    count = f"{np.isfinite(steps).sum()} of {len(steps)}"
    return f"{median:,.0f} ({count})" if np.isfinite(median) else f"never ({count} did)"


def draw_tests(groups: Mapping[str, Group]) -> Figure:
    """Return how the errors of some kinds of robots go on both test sets."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 4.6), layout="constrained")
        panels = figure.subplots(len(groups), len(SETS), sharex=True, sharey=True)
        kinds = {"knn": "nearest neighbours", "mlp": "networks"}
        for row, (kind, robots) in zip(panels, groups.items(), strict=True):
            curves = {
                label: (place, robots[name])
                for place, (name, label) in enumerate(LABELS.items())
                if name in robots
            }
            for panel, (which, title) in zip(row, SETS.items(), strict=True):
                draw_curves(panel, curves, which)
                panel.set_title(f"{title}, {kinds[kind]}", fontsize=8)
            row[0].set_ylabel("Mean error in f2 (scaled)")
        for panel in panels[:-1].flat:
            panel.set_xlabel("")
        legend(figure, panels[0][0].get_legend_handles_labels()[0], n_columns=3)
    return figure


def draw_curves(panel: Axes, curves: Mapping[str, tuple[int, Sequence[Run]]], which: str) -> None:
    """Draw how errors go on a test set: under each label, in the style of a place, of some runs."""
    for label, (place, runs) in curves.items():
        steps, errors = tests_of(runs, which, "absolute")
        style = line_style(place)
        panel.plot(steps, errors.mean(axis=1), label=label, linewidth=1.2, **style)
        panel.fill_between(steps, *band(errors, POSITIVE), **band_style(style["color"]))
    time_axis(panel, int(steps[-1]), n_ticks=4)
    panel.set_yscale("log")
    panel.yaxis.set_major_locator(FixedLocator(ERROR_TICKS))
    panel.yaxis.set_minor_locator(NullLocator())
    panel.yaxis.set_major_formatter("{x:g}")


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
