"""Does learning progress help a learner whose reward is far away? Beside RND and ICM.

    python -m scripts.studies.sparse_reward

SAC (stable-baselines3) learns to reach the far end of a maze: with the maze's reward alone, and
with a bonus for exploration added, which is that of random network distillation, of the intrinsic
curiosity module, or learning progress. Prints how they explored and what they learnt, and how
probably each bonus improves on none, and draws it. With `--pilot` it prints what each bonus does
with several coefficients on other seeds, by which to choose them. Runs that are in the folder
already are not run again. Needs the extras `sb3` and `worlds`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from scripts.studies.sparse_runs import BONUSES, NONE, Outcome, Task, run
from torch_iac.analysis.intervals import (
    PART,
    POSITIVE,
    Estimate,
    band,
    in_words,
    mean,
    probability_larger,
)
from torch_iac.analysis.style import (
    COLOURS,
    LINES,
    STYLE,
    WIDE,
    band_style,
    legend,
    save,
    time_axis,
)

Values = NDArray[np.float64]

LABELS = {NONE: "reward alone", "rnd": "RND", "icm": "ICM", "progress": "learning progress"}
LOOKS: dict[str, dict[str, Any]] = {
    bonus: {"color": colour, "linestyle": line}
    for bonus, colour, line in zip(BONUSES, COLOURS, LINES, strict=False)
}

COEFFICIENTS = {NONE: 0.0, "rnd": 1.0, "icm": 1.0, "progress": 1.0}
"""What each bonus is multiplied by; `--pilot` says how it does with others."""

GRID = (0.2, 1.0, 5.0)
"""What was tried for each."""

PILOT_SEEDS = (100, 101)

N_WINDOWS = 20
"""A curve has so many points."""


@dataclass(frozen=True)
class Measure:
    """What is measured of a run."""

    title: str
    of: Callable[[Outcome], float]
    is_share: bool = True
    sign: int = 1
    """1 if more is better, -1 if less is."""


MEASURES = (
    Measure("success, last quarter", lambda run: run.successes(4)[-1]),
    Measure("success in tests", lambda run: run.passed.mean()),
    Measure("first success (decision)", lambda run: run.first_success, False, -1),
    Measure("maze visited", lambda run: run.coverages(1)[0]),
)


@dataclass(frozen=True)
class Study:
    """How many learners, and for how long."""

    seeds: int = 10
    """How many learn with each bonus, with the seeds 0, 1, ..."""
    steps: int = 10_000
    """How many decisions each takes."""
    hold: int = 5
    """For how many steps of the simulation an action is held."""
    pilot: bool = False
    """Whether coefficients are tried instead, on other seeds."""
    out: Path = Path("runs/sparse_reward")
    """Where the outcomes go, and the figure."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print and draw."""
    if study.pilot:
        others = product(BONUSES[1:], GRID)
        tried = outcomes(study, [(NONE, 0.0), *others], PILOT_SEEDS)
        print_means({f"{LABELS[of]}, {by:g}": runs for (of, by), runs in tried.items()})
        return
    found = outcomes(study, list(COEFFICIENTS.items()), range(study.seeds))
    by_bonus = {bonus: runs for (bonus, _), runs in found.items()}
    print_means({LABELS[bonus]: runs for bonus, runs in by_bonus.items()})
    print_improvements(by_bonus)
    save(draw(by_bonus), study.out / "sparse_reward.png")


def outcomes(
    study: Study, kinds: Sequence[tuple[str, float]], seeds: Sequence[int]
) -> dict[tuple[str, float], list[Outcome]]:
    """Return the runs with each bonus and coefficient, seed after seed."""
    tasks = [Task(*kind, seed, study.steps, study.hold) for seed in seeds for kind in kinds]
    runs = run(tasks, study.out, study.processes)
    return {kind: runs[place :: len(kinds)] for place, kind in enumerate(kinds)}


def print_means(runs: Mapping[str, Sequence[Outcome]]) -> None:
    """Print what is measured of each kind of runs, with intervals."""
    print(f"| | {' | '.join(measure.title for measure in MEASURES)} |")
    print("|---" * (1 + len(MEASURES)) + "|")
    for name, of in runs.items():
        cells = [_cell(measure, of) for measure in MEASURES]
        print(f"| {name} ({len(of)}) | {' | '.join(cells)} |")


def print_improvements(runs: Mapping[str, Sequence[Outcome]]) -> None:
    """Print how probably each bonus improves on none."""
    print(f"\n| improves on {LABELS[NONE]} | {' | '.join(of.title for of in MEASURES)} |")
    print("|---" * (1 + len(MEASURES)) + "|")
    for bonus in BONUSES[1:]:
        cells = [in_words(improvement(of, runs[bonus], runs[NONE])) for of in MEASURES]
        print(f"| {LABELS[bonus]} | {' | '.join(cells)} |")


def _cell(measure: Measure, runs: Sequence[Outcome]) -> str:
    """Return the mean of a measure over runs, and its interval."""
    within = PART if measure.is_share else POSITIVE
    return in_words(mean(values(measure, runs), within), percent=measure.is_share)


def improvement(measure: Measure, one: Sequence[Outcome], other: Sequence[Outcome]) -> Estimate:
    """Return how probably a run of the one is better than a run of the other."""
    return probability_larger(
        measure.sign * values(measure, one), measure.sign * values(measure, other)
    )


def values(measure: Measure, runs: Sequence[Outcome]) -> Values:
    """Return what is measured of each run, shape `(S,)`."""
    return np.array([measure.of(run) for run in runs], np.float64)


def draw(runs: Mapping[str, Sequence[Outcome]]) -> Figure:
    """Return success and coverage over time, and probabilities of improvement."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=WIDE, layout="constrained")
        success, visited, improved = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
        for bonus, of in runs.items():
            draw_curve(success, bonus, of, [run.successes(N_WINDOWS) for run in of])
            draw_curve(visited, bonus, of, [run.coverages(N_WINDOWS) for run in of])
        success.set_ylabel("Episodes that reach the goal")
        visited.set_ylabel("Maze visited")
        draw_improvements(improved, runs)
        key = [Line2D([], [], label=LABELS[bonus], **LOOKS[bonus]) for bonus in runs]
        legend(figure, key)
    return figure


def draw_curve(panel: Axes, bonus: str, runs: Sequence[Outcome], curves: Sequence[Values]) -> None:
    """Draw the mean of runs over time, and its interval."""
    n_decisions = len(runs[0].rewards)
    ends = np.arange(1, N_WINDOWS + 1) * n_decisions / N_WINDOWS
    of_windows = np.stack(curves, axis=1)
    panel.plot(ends, of_windows.mean(axis=1), linewidth=1.2, **LOOKS[bonus])
    panel.fill_between(ends, *band(of_windows, PART), **band_style(LOOKS[bonus]["color"]))
    time_axis(panel, n_decisions, n_ticks=4)
    panel.set_ylim(0, 1)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0))


def draw_improvements(panel: Axes, runs: Mapping[str, Sequence[Outcome]]) -> None:
    """Draw how probably each bonus improves on none, measure by measure, with intervals."""
    panel.axvline(0.5, color="#999999", linewidth=0.8, zorder=0)
    n_rows = len(BONUSES)  # a measure's, and a gap
    for (place, measure), (row, bonus) in product(enumerate(MEASURES), enumerate(BONUSES[1:])):
        found, height = improvement(measure, runs[bonus], runs[NONE]), place * n_rows + row
        panel.plot([found.low, found.high], [height, height], linewidth=1.2, **LOOKS[bonus])
        point = {"color": LOOKS[bonus]["color"], "markersize": 4, "clip_on": False}
        panel.plot([found.value], [height], "o", **point)
    middles = np.arange(len(MEASURES)) * n_rows + 1
    panel.set_yticks(middles, [measure.title.replace(" (", "\n(") for measure in MEASURES])
    panel.invert_yaxis()
    panel.set_xlim(0, 1)
    panel.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    panel.set_xlabel("Probability of\nimprovement")


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
