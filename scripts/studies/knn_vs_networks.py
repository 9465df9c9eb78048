"""Nearest neighbours or networks: which experts serve a curious robot better?

    python -m scripts.studies.knn_vs_networks

Robots of the kinematic room that differ in their experts alone, paired by seed: nearest neighbours,
the default networks and wider ones. Prints Markdown and draws how well they predict, over time.
Runs that are in the folder already, those of `scripts.studies.reproduce_paper` among them, are not
run again.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch
import tyro
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scripts.studies.claims import F1, catching_up, each, focus, last_error, time_in
from scripts.studies.reproduce_paper import (
    SETS,
    VARIANTS,
    draw_curves,
    robots,
    runs_in,
    when_reached,
)
from torch_iac import MLPExperts, load_agent
from torch_iac.analysis.bootstrap import difference, mean
from torch_iac.analysis.generalisation import F2
from torch_iac.analysis.style import COLOURS, STYLE, legend, save
from torch_iac.experiment import experiment_of
from torch_iac.runs.reader import Run
from torch_iac.runs.summary import SETTLING, count_regions

KINDS = {
    "knn": VARIANTS["knn"],
    "mlp": VARIANTS["mlp"],
    "wide": robots(experts=MLPExperts(hidden=(64, 64))),
}
LABELS = {
    "knn": "nearest neighbours",
    "mlp": "networks, 32 and 32",
    "wide": "networks, 64 and 64",
}
REFERENCE = "knn"

N_TIMED = 100
"""How many more decisions are timed at the end of a run."""

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
    torch.set_num_threads(1)
    runs = runs_in("kinematic", KINDS, study.seeds, study)
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
    for name, (run, *_) in runs.items():
        seconds, n_bytes = costs(run)
        print(f"| {LABELS[name]} | {1000 * seconds:.3f} | {n_bytes / 1e3:,.0f} |")


def costs(run: Run) -> tuple[float, float]:
    """Return what a robot takes at the end of a run: seconds of the processor a decision, bytes."""
    agent = load_agent(run.folder)
    n_bytes = sum(tensor.nbytes for tensor in agent.state().values())
    world, _ = experiment_of(run).bounded_world()
    sensors, _ = world.reset(seed=list(run.seeds))  # type: ignore[arg-type]  # a list is fine
    seconds = 0.0
    for _ in range(N_TIMED):
        started = time.process_time()
        actions = agent.act(sensors)
        seconds += time.process_time() - started
        sensors, *_ = world.step(actions)
        started = time.process_time()
        agent.observe(sensors)
        seconds += time.process_time() - started
    world.close()
    return seconds / (N_TIMED * run.n_agents), n_bytes / run.n_agents


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
