"""How much does development depend on the numbers that the paper does not say, or just says?

    python -m scripts.studies.sensitivity

One number at a time is varied around the defaults, in the kinematic room with nearest neighbours.
Draws, and prints as Markdown, the time in f1 and in f2 and the robots that focus on f3 and then on
f2. Runs that are in the folder already are not run again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from scripts.studies.claims import F1, in_order, time_in
from torch_iac import Experiment, IACConfig, KNNExperts
from torch_iac.analysis.generalisation import F2
from torch_iac.analysis.intervals import PART, Estimate, in_words, mean, share
from torch_iac.analysis.style import STYLE, band_style, legend, line_style, save
from torch_iac.compare.engine import run_variants
from torch_iac.runs.reader import Run
from torch_iac.runs.summary import SETTLING


@dataclass(frozen=True)
class Parameter:
    """A number that is varied.

    Attributes:
        title: What it is called, with the paper's symbol.
        values: Its values; the default is among them.
        default: The default.
        experiment: The robots, and their world, for a value.
    """

    title: str
    values: Sequence[float]
    default: float
    experiment: Callable[[float], Experiment]


def robots(**numbers: Any) -> Experiment:
    """Return robots with the paper's numbers but these, and without MP."""
    return Experiment(world="kinematic", config=IACConfig(meta=None, **numbers))


PARAMETERS = {
    "max_examples": Parameter(
        "NS", (60, 125, 250, 500, 1000), 250, lambda value: robots(max_examples=int(value))
    ),
    "delay": Parameter(
        "DELAY",
        (25, 50, 150, 300, 600),
        150,
        lambda value: robots(window=int(value), delay=int(value)),
    ),
    "epsilon": Parameter(
        "epsilon", (0.0, 0.05, 0.1, 0.2, 0.35), 0.1, lambda value: robots(epsilon=value)
    ),
    "n_candidates": Parameter(
        "candidates", (5, 15, 50, 150), 50, lambda value: robots(n_candidates=int(value))
    ),
    "balance": Parameter(
        "balance", (0.0, 0.05, 0.15, 0.3, 0.45), 0.15, lambda value: robots(balance=value)
    ),
    "k": Parameter(
        "k", (1, 3, 5, 10, 20), 1, lambda value: robots(experts=KNNExperts(k=int(value)))
    ),
    "sensor_noise": Parameter(
        "sensor noise (m)",
        (0.0, 0.005, 0.01, 0.02, 0.05),
        0.01,
        lambda value: replace(robots(), world_options={"sensor_noise": value}),
    ),
}

BLOCK = 32
"""How many robots are one run."""

MEASURES: dict[str, Callable[[Sequence[Run]], Estimate]] = {
    "time in f1 after 1,000": lambda runs: mean(time_in(runs, F1, SETTLING), PART),
    "time in f2 after 1,000": lambda runs: mean(time_in(runs, F2, SETTLING), PART),
    "robots that focus on f3, then on f2": lambda runs: share(in_order(runs)),
}


@dataclass(frozen=True)
class Study:
    """How many robots, and for how long."""

    seeds: int = 32
    """How many robots for each value, with the seeds 0, 1, ..."""
    steps: int = 8_000
    """How many decisions each takes."""
    out: Path = Path("runs/sensitivity")
    """Where the run folders and the figure go."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print and draw."""
    places = [(name, value) for name, of in PARAMETERS.items() for value in of.values]
    runs = run_variants(
        study.out,
        {name_of(*place): replace(experiment_of(*place), steps=study.steps) for place in places},
        n_seeds=study.seeds,
        block=BLOCK,
        processes=study.processes,
    )
    found = {
        place: {title: of(runs[name_of(*place)]) for title, of in MEASURES.items()}
        for place in places
    }
    print(f"| parameter | value | {' | '.join(MEASURES)} |\n|---|---|" + "---|" * len(MEASURES))
    for (name, value), measures in found.items():
        cells = [in_words(of, percent=True) for of in measures.values()]
        is_default = value == PARAMETERS[name].default
        mark = f"**{value:g}**" if is_default else f"{value:g}"
        print(f"| {PARAMETERS[name].title} | {mark} | {' | '.join(cells)} |")
    save(draw(found), study.out / "sensitivity.png")


def name_of(name: str, value: float) -> str:
    """Return what robots are called in the folder; those with defaults are the same."""
    return "default" if value == PARAMETERS[name].default else f"{name}={value:g}"


def experiment_of(name: str, value: float) -> Experiment:
    """Return the robots, and their world, with a value."""
    parameter = PARAMETERS[name]
    return robots() if value == parameter.default else parameter.experiment(value)


def draw(found: Mapping[tuple[str, float], Mapping[str, Estimate]]) -> Figure:
    """Return a panel for each parameter, with a curve for each measure."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.6), layout="constrained")
        panels = figure.subplots(2, 4, sharey=True)
        for panel, (name, parameter) in zip(panels.flat, PARAMETERS.items(), strict=False):
            _draw_panel(panel, parameter, [found[name, value] for value in parameter.values])
        panels[0, 0].set_ylim(0, 1)
        for row in panels:
            row[0].yaxis.set_major_formatter(PercentFormatter(1.0))
        panels[-1, -1].axis("off")
        legend(figure, panels[0, 0].get_legend_handles_labels()[0], n_columns=3)
    return figure


def _draw_panel(panel: Axes, parameter: Parameter, found: Sequence[Mapping[str, Estimate]]) -> None:
    """Draw the measures over a parameter's values, which stand at equal distances."""
    places = range(len(parameter.values))
    for place, title in enumerate(MEASURES, 1):
        of = [measures[title] for measures in found]
        style, (low, high) = line_style(place), ([e.low for e in of], [e.high for e in of])
        panel.plot(places, [e.value for e in of], marker="o", label=title, markersize=3, **style)
        panel.fill_between(places, low, high, **band_style(style["color"]))
    panel.axvline(parameter.values.index(parameter.default), color="#999999", linewidth=0.8)
    panel.set_xticks(places, [f"{value:g}" for value in parameter.values])
    panel.set_title(parameter.title, fontsize=8)


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
