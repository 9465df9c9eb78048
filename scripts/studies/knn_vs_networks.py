"""Nearest neighbours or networks: which experts serve a curious robot better?

    python -m scripts.studies.knn_vs_networks

Robots of the kinematic room that differ in their experts alone, paired by seed: nearest neighbours,
the default networks, wider ones, and both in each region. Prints Markdown and draws how well they
predict, over time, and where those that have both use the network.
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
from torch_iac import HybridExperts, MLPExperts, load_agent
from torch_iac.analysis.generalisation import F2
from torch_iac.analysis.intervals import PART, POSITIVE, Range, difference, in_words, mean
from torch_iac.analysis.style import (
    STYLE,
    band_style,
    legend,
    name_lines,
    save,
    time_axis,
    zone_colour,
    zone_style,
)
from torch_iac.experiment import experiment_of
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import USED_NETWORK, WINDOW
from torch_iac.runs.statistics import known_mean
from torch_iac.runs.summary import SETTLING, count_regions

KINDS = {
    "knn": VARIANTS["knn"],
    "mlp": VARIANTS["mlp"],
    "wide": robots(experts=MLPExperts(hidden=(64, 64))),
    "hybrid": robots(experts=HybridExperts()),
}
LABELS = {
    "knn": "nearest neighbours",
    "mlp": "networks, 32 and 32",
    "wide": "networks, 64 and 64",
    "hybrid": "both in each region",
}
REFERENCE = "knn"

N_SPANS = 5
"""Into how many spans of time the table of shares divides a run."""

N_UNTIMED, N_TIMED = 50, 200
"""How many more decisions are taken at the end of a run; the first untimed, since a process is
slower at its beginning."""

Values = NDArray[np.float64]

MEASURES: dict[str, tuple[Callable[[Sequence[Run]], Values], Range]] = {
    "error in f2 at the end, contexts met": (
        lambda runs: last_error(runs, "met", "absolute"),
        POSITIVE,
    ),
    "error in f2 at the end, anywhere": (
        lambda runs: last_error(runs, "anywhere", "absolute"),
        POSITIVE,
    ),
    "focus on f3 (decision)": (lambda runs: focus(runs, "f3"), POSITIVE),
    "focus on f2 (decision)": (lambda runs: focus(runs, "f2"), POSITIVE),
    "time in f1 after 1,000": (lambda runs: time_in(runs, F1, SETTLING), PART),
    "time in f2 after 1,000": (lambda runs: time_in(runs, F2, SETTLING), PART),
    "regions at the end": (lambda runs: each(runs, count_regions), POSITIVE),
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
    print_network_shares(runs["hybrid"])
    save(draw(runs), study.out / "knn_vs_networks.png")
    save(draw_network_shares(runs["hybrid"]), study.out / "network_share.png")


def print_differences(runs: Mapping[str, Sequence[Run]]) -> None:
    """Print each measure of each kind, and how it differs from nearest neighbours, paired."""
    others = [name for name in runs if name != REFERENCE]
    counts = {name: sum(run.n_agents for run in of) for name, of in runs.items()}
    titles = [f"{LABELS[name]} ({counts[name]})" for name in runs]
    titles += [f"{LABELS[name]}: difference" for name in others]
    print(f"| | {' | '.join(titles)} |\n{'|---' * (1 + len(titles))}|")
    for title, (measure, within) in MEASURES.items():
        values = {name: measure(of) for name, of in runs.items()}
        cells = [_cell(of, None, within) for of in values.values()]
        cells += [_cell(values[name], values[REFERENCE], within) for name in others]
        print(f"| {title} | {' | '.join(cells)} |")
    for which, title in SETS.items():
        reached = [catching_up(runs[name], runs[REFERENCE], which) for name in others]
        cells = ["", *map(when_reached, reached)]
        blanks = [""] * len(others)
        title = f"as good as nearest neighbours at last, {title[0].lower()}{title[1:]} (decision)"
        print(f"| {title} | {' | '.join([*cells, *blanks])} |")


def _cell(values: Values, less: Values | None, within: Range) -> str:
    """Return a mean, or that of a difference, over the robots that have it, and its interval."""
    known = np.isfinite(values) if less is None else np.isfinite(values) & np.isfinite(less)
    found = mean(values[known], within) if less is None else difference(values[known], less[known])
    few = "" if known.all() else f", {known.sum()} robots"
    return in_words(found, percent=within == PART) + few


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
    seconds = []
    for _ in range(N_UNTIMED + N_TIMED):
        started = time.process_time()
        actions = agent.act(sensors)
        acted = time.process_time()
        sensors, *_ = world.step(actions)
        moved = time.process_time()
        agent.observe(sensors)
        seconds.append(acted - started + time.process_time() - moved)
    world.close()
    return sum(seconds[N_UNTIMED:]) / (N_TIMED * run.n_agents), n_bytes / run.n_agents


def network_shares(runs: Sequence[Run]) -> Values:
    """Return in which share of its decisions each robot used the network, shape `(A, W, Z)`.

    By windows of `WINDOW` decisions and zones; NaN where there was no decision.
    """
    shares = [run.window_sums.means(USED_NETWORK).swapaxes(0, 1) for run in runs]
    return np.concatenate(shares)


def print_network_shares(runs: Sequence[Run]) -> None:
    """Print where and when robots that have both use the network, the mean over robots."""
    shares, zones = network_shares(runs), runs[0].zone_names
    n_windows = shares.shape[1]
    print(f"\n| decisions | {' | '.join(zones)} |\n|---{'|---' * len(zones)}|")
    for first in range(0, n_windows, max(1, n_windows // N_SPANS)):
        last = min(first + max(1, n_windows // N_SPANS), n_windows)
        with np.errstate(invalid="ignore"):
            by_robot = known_mean(shares[:, first:last], axis=1)
        cells = []
        for of_zone in by_robot.T:
            cells.append(in_words(mean(of_zone[np.isfinite(of_zone)], PART), percent=True))
        span = f"{first * WINDOW:,} to {last * WINDOW:,}"
        print(f"| {span} | {' | '.join(cells)} |")


def draw_network_shares(runs: Sequence[Run]) -> Figure:
    """Return the share of decisions for which the network was used, by zone, over time."""
    shares = network_shares(runs)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.2, 2.7), layout="constrained")
        panel = figure.subplots()
        steps = (np.arange(shares.shape[1]) + 1) * WINDOW
        for zone, name in enumerate(runs[0].zone_names):
            found = [mean(of[np.isfinite(of)], PART) for of in shares[:, :, zone].T]
            means, low, high = np.array([(of.value, of.low, of.high) for of in found]).T
            panel.plot(steps, means, label=name, linewidth=1.2, **zone_style(zone))
            panel.fill_between(steps, low, high, **band_style(zone_colour(zone)))
        panel.set(ylabel="Share of decisions with the network", ylim=(0, 1))
        time_axis(panel, int(steps[-1]))
        name_lines(figure, panel)
        panel.axhline(0.5, color="0.8", linewidth=0.8, zorder=0)
    return figure


def draw(runs: Mapping[str, Sequence[Run]]) -> Figure:
    """Return how the errors of each kind go on both test sets."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 2.7), layout="constrained")
        panels = figure.subplots(1, len(SETS), sharey=True)
        curves = {LABELS[name]: (place, of) for place, (name, of) in enumerate(runs.items())}
        for panel, (which, title) in zip(panels, SETS.items(), strict=True):
            draw_curves(panel, curves, which)
            panel.set_title(title, fontsize=8)
        panels[0].set_ylabel("Mean error in f2 (scaled)")
        legend(figure, panels[0].get_legend_handles_labels()[0], n_columns=4)
    return figure


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
