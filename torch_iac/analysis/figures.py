"""Figures 2 and 3 of the 2004 paper, errors and expectations, drawn from any run folder.

Colours are Okabe and Ito's, which colour-blind readers tell apart.
"""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from torch_iac.analysis.intervals import PART, band
from torch_iac.analysis.region_history import ErrorCurve, error_curves, region_zones
from torch_iac.analysis.style import (
    MIXED_COLOUR,
    SIZE,
    STYLE,
    WIDE,
    band_style,
    expert_colour,
    legend,
    legend_line,
    time_axis,
    zone_colour,
)
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.schema import MAIN, WINDOW
from torch_iac.runs.statistics import Calibration, calibration, known_mean, zone_errors, zone_shares

LEAST_PURITY = 2 / 3
"""A region has the colour of a zone if so many of its decisions were in it."""

DECILES: dict[str, Any] = {"color": "black", "marker": "o", "markersize": 3.5, "linewidth": 0.8}
"""Style of the curve of deciles."""

MAX_POINTS = 400
"""A curve is drawn with at most so many points."""


def save_figures(folder: Path | str, pdf: bool = False) -> list[Path]:
    """Draw the figures of a run into its folder, under `figures/`, and return where they are.

    `experts.png` is figure 2, of agent 0; `zones.png` is figure 3, for worlds that have zones;
    `errors.png` compares the experts with their shadows, if there are any; `calibration.png` shows
    whether errors are what MP expected, if there is one.

    Args:
        folder: The run folder.
        pdf: Also write each as a vector graphic.

    Raises:
        FileNotFoundError: The folder holds no run, or no decisions yet.
    """
    run = load_run(folder)
    figures = {"experts": draw_experts(run)}
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
                figure.savefig(paths[-1], dpi=220)
    return paths


def draw_experts(run: Run, agent: int = 0, window: int | None = None) -> Figure:
    """Return figure 2: the tree of an agent's experts, by the mean error of each over time.

    A curve is the mean of the last `window` errors of a region, each error being the mean absolute
    difference (or as the run's config says) between prediction and outcome, in scaled units. It
    lasts from the region's birth to its split, where the curves of its two children begin (if they
    inherit its errors). Its colour is the zone that it mostly covers, or its depth in a world
    without zones.

    Args:
        run: The run.
        agent: Whose experts.
        window: How many errors the mean is over; the run's own `error_window` if none is given.

    Raises:
        ValueError: There is no such agent, or its steps are not recorded.

    Source: Oudeyer and Kaplan (2004), figure 2.
    """
    window = run.error_window if window is None else window
    curves = error_curves(run, agent, window)
    with mpl.rc_context(STYLE):
        figure, axes = _axes(run.n_decisions)
        colours, key = region_colours(run, agent)
        axes.add_collection(
            LineCollection(
                [_points(curve) for curve in curves],
                colors=[colours[curve.region] for curve in curves],
                linewidths=0.9 if len(curves) < 60 else 0.6,
                capstyle="round",
            )
        )
        axes.autoscale_view(scalex=False)
        axes.set_ylim(bottom=0)
        axes.set_ylabel(f"Mean of last {window} errors (scaled)")
        legend(figure, [legend_line(colour, name) for name, colour in key.items()])
    return figure


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
        for zone in range(len(run.zone_names)):
            colour, mean = zone_colour(zone), shares[:, :, zone].mean(axis=1)
            axes.plot(middles, mean, color=colour, linewidth=1.2)
            axes.fill_between(middles, low[:, zone], high[:, zone], **band_style(colour))
        axes.set_ylim(0, 1)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylabel(f"Share of time in {window} decisions")
        key: list[Line2D | Patch] = [
            legend_line(zone_colour(zone), name) for zone, name in enumerate(run.zone_names)
        ]
        if run.n_agents > 1:
            label = f"95 % CI\nof the mean, {run.n_agents:,} agents"
            key.append(Patch(label=label, **band_style(MIXED_COLOUR)))
        legend(figure, key)
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
        for place, column in enumerate(run.error_columns.values()):
            errors = zone_errors(run, column, window)  # (W, A, Z)
            middles = (np.arange(len(errors)) + 0.5) * window
            for zone, panel in enumerate(panels):
                means = known_mean(errors[:, :, zone], axis=1)
                panel.plot(middles, means, color=expert_colour(place), linewidth=1.2)
            if (errors > 0).any():
                panels[0].set_yscale("log")  # and with it the others
        for zone, name in enumerate(run.zone_names):
            panels[zone].set_title(name, color=zone_colour(zone), fontsize=8, fontweight="bold")
        panels[0].set_ylabel(f"Mean error in {window} decisions (scaled)")
        key = ["main experts" if name == MAIN else name for name in run.error_columns]
        legend(figure, [legend_line(expert_colour(place), name) for place, name in enumerate(key)])
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
        axes.set_aspect("equal")
        axes.axline((0.01, 0.01), (0.1, 0.1), color=MIXED_COLOUR, linewidth=0.8, zorder=0)
        axes.plot(found.expected, found.actual, **DECILES)
        for zone, (name, of) in enumerate(found.zones.items()):
            axes.plot(of.expected, of.actual, "D", color=zone_colour(zone), markersize=5)
            axes.annotate(
                name,
                (of.expected, of.actual),
                (6, -7),
                textcoords="offset points",
                color=zone_colour(zone),
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


def region_colours(run: Run, agent: int = 0) -> tuple[list[str], dict[str, str]]:
    """Return the colour of each region, and what colours mean.

    It is that of the zone which the region mostly covers, or of its depth in a world without zones.

    Raises:
        ValueError: There is no such agent, or, in a world with zones, its steps are not recorded.
    """
    return _zone_colours(run, agent) if run.zone_names else _depth_colours(run, agent)


def _zone_colours(run: Run, agent: int) -> tuple[list[str], dict[str, str]]:
    cover = region_zones(run, agent)
    colours = [
        zone_colour(zone) if purity >= LEAST_PURITY else MIXED_COLOUR
        for zone, purity in zip(cover.zone.tolist(), cover.purity.tolist(), strict=True)
    ]
    key = {name: zone_colour(zone) for zone, name in enumerate(run.zone_names)}
    return colours, {**key, "several zones": MIXED_COLOUR}


def _depth_colours(run: Run, agent: int) -> tuple[list[str], dict[str, str]]:
    """Return the colour of each region by its depth in the tree, and what colours mean."""
    depths = run.family(agent)["depth"].to_numpy()
    deepest = max(1, int(depths.max()))
    shade = [to_hex(mpl.colormaps["viridis"](0.9 * d / deepest)) for d in range(deepest + 1)]
    shown = sorted({0, deepest // 2, deepest})
    return [shade[depth] for depth in depths], {f"depth {d}": shade[d] for d in shown}


def _points(curve: ErrorCurve) -> NDArray[np.float64]:
    """Return the points of a curve, shape `(P, 2)`, thinned out if there are too many."""
    n_points = len(curve.decisions)
    kept = np.unique(np.linspace(0, n_points - 1, min(n_points, MAX_POINTS)).round().astype(int))
    return np.stack([curve.decisions[kept], curve.mean_errors[kept]], axis=1)
