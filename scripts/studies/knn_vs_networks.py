"""Nearest neighbours or networks: which experts serve a curious robot better?

    python -m scripts.studies.knn_vs_networks

Robots of the kinematic room that differ in their experts alone, paired by seed: nearest neighbours,
the default networks and wider ones. Prints Markdown and draws how well they predict, over time.
Runs that are in the folder already, those of `scripts.studies.reproduce_paper` among them, are not
run again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import tyro
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scripts.studies.claims import F1, catching_up, each, focus, last_error, time_in
from scripts.studies.reproduce_paper import (
    SETS,
    VARIANTS,
    Variant,
    draw_curves,
    life_of,
    when_reached,
)
from scripts.studies.study import COSTS, live_all
from torch_iac import IACConfig, MLPExperts
from torch_iac.analysis.bootstrap import difference, mean
from torch_iac.analysis.generalisation import F2
from torch_iac.analysis.style import COLOURS, STYLE, legend, save
from torch_iac.internal.files import parse_json
from torch_iac.runs.reader import Run
from torch_iac.runs.summary import SETTLING, count_regions

KINDS = {
    "knn": VARIANTS["knn"],
    "mlp": VARIANTS["mlp"],
    "wide": Variant(IACConfig(experts=MLPExperts(hidden=(64, 64)))),
}
LABELS = {
    "knn": "nearest neighbours",
    "mlp": "networks, 32 and 32",
    "wide": "networks, 64 and 64",
}
REFERENCE = "knn"

Values = NDArray[np.float64]

MEASURES: dict[str, tuple[Callable[[Sequence[Run]], Values], str]] = {
    "error in f2 at the end, contexts met": (
        lambda runs: last_error(runs, "met", "absolute"),
        ".4f",
    ),
    "error in f2 at the end, anywhere": (
        lambda runs: last_error(runs, "anywhere", "absolute"),
        ".4f",
    ),
    "focus on f3 (decision)": (lambda runs: focus(runs, "f3"), ",.0f"),
    "focus on f2 (decision)": (lambda runs: focus(runs, "f2"), ",.0f"),
    "time in f1 after 1,000": (lambda runs: time_in(runs, F1, SETTLING), ".1%"),
    "time in f2 after 1,000": (lambda runs: time_in(runs, F2, SETTLING), ".1%"),
    "regions at the end": (lambda runs: each(runs, count_regions), ".1f"),
}


@dataclass(frozen=True)
class Study:
    """How many robots, and for how long."""

    seeds: int = 100
    """How many robots of each kind, with the seeds 0, 1, ..."""
    steps: int = 10_000
    """How many decisions each takes."""
    out: Path = Path("runs/paper")
    """Where the run folders and the figure go."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print and draw."""
    seeds = range(study.seeds)
    lives = [
        life_of(study.out, "kinematic", name, kind, seeds, study.steps)
        for name, kind in KINDS.items()
    ]
    runs = {name: [run] for name, run in zip(KINDS, live_all(lives, study.processes), strict=True)}
    print_differences(runs)
    print_costs(runs)
    save(draw(runs), study.out / "knn_vs_networks.png")


def print_differences(runs: Mapping[str, Sequence[Run]]) -> None:
    """Print each measure of each kind, and how it differs from nearest neighbours, paired."""
    others = [name for name in runs if name != REFERENCE]
    counts = {name: sum(run.n_agents for run in of) for name, of in runs.items()}
    titles = [f"{LABELS[name]} ({counts[name]})" for name in runs]
    titles += [f"{LABELS[name]}: difference" for name in others]
    print(f"| | {' | '.join(titles)} |\n{'|---' * (1 + len(titles))}|")
    for title, (measure, unit) in MEASURES.items():
        values = {name: measure(of) for name, of in runs.items()}
        cells = [_cell(of, None, unit) for of in values.values()]
        cells += [_cell(values[name], values[REFERENCE], unit) for name in others]
        print(f"| {title} | {' | '.join(cells)} |")
    for which, title in SETS.items():
        reached = [catching_up(runs[name], runs[REFERENCE], which) for name in others]
        cells = ["", *map(when_reached, reached)]
        blanks = [""] * len(others)
        title = f"as good as nearest neighbours at last, {title[0].lower()}{title[1:]} (decision)"
        print(f"| {title} | {' | '.join([*cells, *blanks])} |")


def _cell(values: Values, less: Values | None, unit: str) -> str:
    """Return a mean, or that of a difference, over the robots that have it, and its interval."""
    known = np.isfinite(values) if less is None else np.isfinite(values) & np.isfinite(less)
    found = mean(values[known]) if less is None else difference(values[known], less[known])
    sign = "" if less is None else "+"
    value = format(found.value, sign + unit)
    few = "" if known.all() else f", {known.sum()} robots"
    return f"{value} ({format(found.low, unit)} to {format(found.high, unit)}{few})"


def print_costs(runs: Mapping[str, Sequence[Run]]) -> None:
    """Print what a robot costs."""
    print("\n| | ms a decision of a robot | memory of a robot (kB) |\n|---|---|---|")
    for name, (run,) in runs.items():
        costs = parse_json((run.folder / COSTS).read_bytes())
        each_ms = 1000 * costs["agent_seconds"] / (run.n_agents * run.n_decisions)
        print(
            f"| {LABELS[name]} | {each_ms:.3f} | {costs['state_bytes'] / run.n_agents / 1e3:,.0f} |"
        )


def draw(runs: Mapping[str, Sequence[Run]]) -> Figure:
    """Return how the errors of each kind go on both test sets."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 2.7), layout="constrained")
        panels = figure.subplots(1, len(SETS), sharey=True)
        of_colours = zip(COLOURS, runs.items(), strict=False)
        curves = {LABELS[name]: (colour, of) for colour, (name, of) in of_colours}
        for panel, (which, title) in zip(panels, SETS.items(), strict=True):
            draw_curves(panel, curves, which)
            panel.set_title(title, fontsize=8)
        panels[0].set_ylabel("Mean error in f2 (scaled)")
        legend(figure, panels[0].get_legend_handles_labels()[0], n_columns=3)
    return figure


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
