"""Is curiosity worth more where random actions seldom lead to what can be learnt?

    python -m scripts.studies.rarity

In the paper's room a third of all sounds is in f2, so that robots which act at random practise it
much. Here f2 and f3 are a smaller and smaller part of the sounds, and f1, where nothing can be
learnt, is the rest. Prints how well robots of each drive come to predict f2, beside RANDOM, and
draws it. Runs that are in the folder already, those of `scripts.studies.reproduce_paper` among
them, are not run again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, PercentFormatter
from numpy.typing import NDArray

from scripts.studies.claims import F1, LATE, last_error, ratio, time_in
from scripts.studies.reproduce_paper import LABELS, SETS, VARIANTS, runs_in
from torch_iac import Experiment
from torch_iac.analysis.generalisation import F2
from torch_iac.analysis.intervals import PART, POSITIVE, Estimate, in_words, mean
from torch_iac.analysis.style import COLOURS, STYLE, legend, save
from torch_iac.runs.reader import Run

Values = NDArray[np.float64]
Place = tuple[float, str]
"""The part of the sounds that is in f2, and the kind of robots."""
Errors = Mapping[tuple[Place, str], Values]
"""The last error of each robot, by its place and the test set."""

COMMON = 1 / 3
"""The part of the sounds that is in f2, and in f3, in the paper's room."""

KINDS = {"knn": "nearest neighbours", "mlp": "networks"}
DRIVES = {"": "iac", "-random": "random", "-proportional": "proportional"}
LOOKS: dict[str, dict[str, Any]] = {
    kind + drive: {
        "label": f"{LABELS[DRIVES[drive]]}, {KINDS[kind]}",
        "color": COLOURS[list(LABELS).index(DRIVES[drive])],
        "markerfacecolor": face,
        "linestyle": style,
    }
    for drive in ("", "-proportional")
    for kind, face, style in (("knn", "auto", "-"), ("mlp", "white", "--"))
}
"""How what is beside RANDOM looks in the figure."""

RATIO_TICKS = (0.8, 1, 1.25, 1.5, 2)


@dataclass(frozen=True)
class Study:
    """How rare f2 is, how many robots there are, and for how long."""

    parts: tuple[float, ...] = (0.1, 0.03)
    """Parts of the sounds that are in f2, and as many in f3, besides the paper's third."""
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
    parts = (COMMON, *study.parts)
    runs = runs_of(study, parts)
    errors = {
        (place, which): last_error(of, which, "absolute")
        for place, of in runs.items()
        for which in SETS
    }
    print_table(runs, errors)
    save(draw(errors, parts), study.out / "rarity.png")


def runs_of(study: Study, parts: Sequence[float]) -> dict[Place, list[Run]]:
    """Return the runs, by the part of the sounds that is in f2 and by the kind of robots."""
    places = [(part, kind + drive) for part in parts for kind in KINDS for drive in DRIVES]
    experiments = {name_of(*place): experiment_of(*place) for place in places}
    runs = runs_in("kinematic", experiments, study.seeds, study)
    return {place: runs[name_of(*place)] for place in places}


def name_of(part: float, name: str) -> str:
    """Return what robots are called in the folder: as in the other study where f2 is common."""
    return name if part == COMMON else f"{name}-f2-{part:g}"


def experiment_of(part: float, name: str) -> Experiment:
    """Return such robots, in a room where f2 and f3 have that part of the sounds each."""
    if part == COMMON:
        return VARIANTS[name]
    return replace(VARIANTS[name], world_options={"f1_end": 1 - 2 * part, "f2_end": 1 - part})


def print_table(runs: Mapping[Place, Sequence[Run]], errors: Errors) -> None:
    """Print how robots spend their time and predict f2, beside RANDOM of their own kind."""
    titles = ["sounds in f2", "robots", "time in f1", "in f2"]
    titles += [t for where in SETS.values() for t in (f"error: {where}", "of RANDOM's")]
    print(f"| {' | '.join(titles)} |\n{'|---' * len(titles)}|")
    for (part, name), mine in runs.items():
        cells = [f"{part:.0%}", name]
        cells += [
            in_words(mean(time_in(mine, zone, LATE), PART), percent=True) for zone in (F1, F2)
        ]
        for which in SETS:
            cells.append(in_words(mean(errors[(part, name), which], POSITIVE)))
            cells.append(in_words(beside_random(errors, part, name, which)))
        print(f"| {' | '.join(cells)} |")


def beside_random(errors: Errors, part: float, name: str, which: str) -> Estimate:
    """Return how many times RANDOM's last error on a test set theirs is."""
    random = f"{name.partition('-')[0]}-random"
    return ratio(errors[(part, name), which], errors[(part, random), which])


def draw(errors: Errors, parts: Sequence[float]) -> Figure:
    """Return the errors beside RANDOM's over how common f2 is, on both test sets."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.0), layout="constrained")
        panels = figure.subplots(1, len(SETS), sharey=True)
        for panel, (which, title) in zip(panels, SETS.items(), strict=True):
            for number, (name, look) in enumerate(LOOKS.items()):
                found = [beside_random(errors, part, name, which) for part in parts]
                shifted = np.array(parts) * (1 + 0.04 * (number - 1.5))  # so that bars stay apart
                draw_estimates(panel, shifted, found, look)
            panel.axhline(1, color="0.6", linewidth=0.8, zorder=0)
            panel.set_title(title, fontsize=8)
            panel.set_xlabel("Sounds in f2")
            part_axis(panel, parts)
        panels[0].set_ylabel("Error in f2, times RANDOM's")
        legend(figure, panels[0].get_legend_handles_labels()[0], n_columns=2)
    return figure


def draw_estimates(
    panel: Axes, places: Values, found: Sequence[Estimate], look: Mapping[str, Any]
) -> None:
    """Draw some estimates with their intervals."""
    values, lows, highs = np.array([(of.value, of.low, of.high) for of in found]).T
    panel.errorbar(
        places, values, (values - lows, highs - values), **look, marker="o", ms=4, linewidth=1.2
    )


def part_axis(panel: Axes, parts: Sequence[float]) -> None:
    """Let a panel go from where f2 is common to where it is rare."""
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.invert_xaxis()
    panel.xaxis.set_major_locator(FixedLocator(parts))
    panel.xaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    panel.yaxis.set_major_locator(FixedLocator(RATIO_TICKS))
    panel.yaxis.set_major_formatter("{x:g}")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_minor_locator(NullLocator())


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
