"""The figures of any run folder: figure 3 of the 2004 paper, errors and expectations."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from torch_iac.analysis.family_tree import draw_experts, draw_tree
from torch_iac.analysis.intervals import PART, band
from torch_iac.analysis.style import (
    DPI,
    MIXED_COLOUR,
    SIZE,
    STYLE,
    WIDE,
    band_style,
    legend,
    line_style,
    name_lines,
    plain_errors,
    time_axis,
    zone_colour,
    zone_marker,
    zone_style,
)
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.schema import MAIN, WINDOW
from torch_iac.runs.statistics import Calibration, calibration, known_mean, zone_errors, zone_shares

DECILES: dict[str, Any] = {"color": "black", "marker": "o", "markersize": 3.5, "linewidth": 0.8}
"""Style of the curve of deciles."""


def save_figures(folder: Path | str, pdf: bool = False) -> list[Path]:
    """Draw the figures of a run into its folder, under `figures/`, and return where they are.

    `experts.png` is figure 2, of agent 0, and `tree.png` shows where its regions are cut;
    `zones.png` is figure 3, for worlds that have zones;
    `errors.png` compares the experts with their shadows, if there are any; `calibration.png` shows
    whether errors are what MP expected, if there is one.

    Args:
        folder: The run folder.
        pdf: Also write each as a vector graphic.

    Raises:
        FileNotFoundError: The folder holds no run, or no decisions yet.
    """
    run = load_run(folder)
    figures = {"experts": draw_experts(run), "tree": draw_tree(run)}
    if run.zone_names:
        figures["zones"] = draw_zones(run)
    if run.shadow_names:
        figures["errors"] = draw_errors(run)
    if run.has_expectations:
        figures["calibration"] = draw_calibration(run)
    target = run.folder / "figures"
    target.mkdir(exist_ok=True)
    paths = []
    for name, figure in figures.items():
        for kind in ("png", "pdf") if pdf else ("png",):
            paths.append(target / f"{name}.{kind}")
            with mpl.rc_context(STYLE):
                figure.savefig(paths[-1], dpi=DPI)
    return paths


def draw_zones(run: Run, window: int = WINDOW) -> Figure:
    """Return figure 3: the share of its time that the robot spends in each zone, over time.

    For several agents, recorded one by one or not, lines are means and bands their 95 % confidence
    intervals (Student's t).

    Args:
        run: The run.
        window: Over how many decisions shares are taken; a shorter run is one window.

    Raises:
        ValueError: The world has no zones, or no windows of that size were kept.

    Source: Oudeyer and Kaplan (2004), figure 3.
    """
    if not run.zone_names:
        raise ValueError(f"the world of {run.folder} has no zones, so there are no shares to draw")
    window = min(window, run.n_decisions)
    shares = zone_shares(run, window)
    middles = (np.arange(len(shares)) + 0.5) * window
    low, high = band(shares.swapaxes(1, 2), PART)
    with mpl.rc_context(STYLE):
        figure, axes = _axes(run.n_decisions)
        means = shares.mean(axis=1)
        for zone, name in enumerate(run.zone_names):
            axes.plot(middles, means[:, zone], linewidth=1.2, label=name, **zone_style(zone))
            axes.fill_between(middles, low[:, zone], high[:, zone], **band_style(zone_colour(zone)))
        axes.set_ylim(0, 1)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylabel(f"Share of time in {window} decisions")
        name_lines(figure, axes)
        if run.n_agents > 1:
            label = f"95 % CI of the mean, {run.n_agents:,} agents"
            legend(figure, [Patch(label=label, **band_style(MIXED_COLOUR))])
    return figure


def draw_errors(run: Run, window: int = WINDOW) -> Figure:
    """Return the mean errors of the experts and of their shadows over time, zone by zone.

    All predict the same decisions. Means are over agents, on a logarithmic axis, in scaled units.

    Args:
        run: The run.
        window: Over how many decisions errors are averaged; a shorter run is one window.

    Raises:
        ValueError: No windows of that size were kept.
    """
    window = min(window, run.n_decisions)
    names = run.zone_names or ("",)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=WIDE if run.zone_names else SIZE, layout="constrained")
        panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for panel in panels:
            time_axis(panel, run.n_decisions)
        for place, (name, column) in enumerate(run.error_columns.items()):
            label = "main experts" if name == MAIN else name
            errors = zone_errors(run, column, window)  # (W, A, Z)
            middles = (np.arange(len(errors)) + 0.5) * window
            for zone, panel in enumerate(panels):
                means = known_mean(errors[:, :, zone], axis=1)
                panel.plot(middles, means, linewidth=1.2, label=label, **line_style(place))
            if (errors > 0).any():
                panels[0].set_yscale("log")  # and with it the others
                plain_errors(panels[0].yaxis)
        for zone, name in enumerate(run.zone_names):
            panels[zone].set_title(name, color=zone_colour(zone), fontsize=8, fontweight="bold")
        panels[0].set_ylabel(f"Mean error in {window} decisions (scaled)")
        name_lines(figure, panels[-1])
    return figure


def draw_calibration(run: Run) -> Figure:
    """Return whether errors are what MP expected: by decile of the expectation, and by zone.

    Both are in scaled units, on logarithmic axes, and means over the decisions that
    `statistics.calibration` takes. Above the diagonal, errors are larger than expected.

    Raises:
        ValueError: The run has no MP.
    """
    found = calibration(run)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.5, 3.4), layout="constrained")
        axes = figure.subplots()
        axes.set_xscale("log")
        axes.set_yscale("log")
        plain_errors(axes.xaxis)
        plain_errors(axes.yaxis)
        axes.set_aspect("equal")
        axes.axline((0.01, 0.01), (0.1, 0.1), color=MIXED_COLOUR, linewidth=0.8, zorder=0)
        axes.plot(found.expected, found.actual, **DECILES)
        for zone, (name, of) in enumerate(found.zones.items()):
            colour = zone_colour(zone)
            axes.plot(of.expected, of.actual, zone_marker(zone), color=colour, markersize=5)
            axes.annotate(
                name,
                (of.expected, of.actual),
                (6, -7),
                textcoords="offset points",
                color=colour,
                fontweight="bold",
                fontsize=7,
            )
        _square(axes, found)
        axes.set_xlabel("Error expected by MP (scaled)")
        axes.set_ylabel("Mean error (scaled)")
        legend(
            figure,
            [
                Line2D(
                    [], [], label=f"tenths of decisions from {found.first_step:,} on", **DECILES
                ),
                Line2D([], [], color=MIXED_COLOUR, linewidth=0.8, label="as expected"),
            ],
        )
    return figure


def _square(axes: Axes, found: Calibration) -> None:
    """Show the same errors along both axes."""
    points = [(of.expected, of.actual) for of in found.zones.values()]
    shown = np.concatenate([found.expected, found.actual, *map(np.array, points)])
    shown = shown[shown > 0]
    if len(shown):
        limits = (shown.min() / 1.5, shown.max() * 1.5)
        axes.set_xlim(limits)
        axes.set_ylim(limits)


def _axes(n_decisions: int) -> tuple[Figure, Axes]:
    """Return a figure of one column, with time along the horizontal axis."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplots()
    time_axis(axes, n_decisions)
    return figure, axes
