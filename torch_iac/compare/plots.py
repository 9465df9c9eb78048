"""Pictures of a comparison: shares and errors over time, and probabilities of improvement.

Shapes: `W` windows of decisions, `S` seeds, `Z` zones.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from torch_iac.analysis.intervals import PART, POSITIVE, Estimate, Range, band
from torch_iac.analysis.style import (
    COLOURS,
    PANELS_A_ROW,
    STYLE,
    band_style,
    line_style,
    name_lines,
    plain_errors,
    time_axis,
)
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import WINDOW
from torch_iac.runs.statistics import known_mean, summed_up

EVERYWHERE = "everywhere"
"""Name of all zones together."""

WIDTH = 7.0
"""Inches: the whole width of a page."""

N_TICKS = 3
"""Ticks along the time of a panel, at most; more would touch those of the next panel."""

LEGEND_LETTERS = 90
"""Characters that fit into a row of the legend."""


@dataclass(frozen=True)
class Curves:
    """Curves over time of the runs of one variant.

    Attributes:
        zone_names: The zones of their world.
        window: How many decisions each window has.
        shares: Shape `(W, S, Z)`: of the time, in each zone.
        errors: Shape `(W, S, 1 + Z)`: the mean error, in all and in each zone, in scaled units; NaN
            without decisions.
    """

    zone_names: tuple[str, ...]
    window: int
    shares: NDArray[np.float64]
    errors: NDArray[np.float64]

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Self:
        """Return the curves of runs of one variant, up to the shortest."""
        window = min(WINDOW, *(run.n_decisions for run in runs))
        kept = [summed_up(run, "error", window) for run in runs]
        n_windows = min(len(of.counts) for of in kept)
        kept = [of[:n_windows] for of in kept]
        n_zones = len(runs[0].zone_names)
        errors = [
            np.concatenate([of.total(2).means("error"), of.means("error")[..., :n_zones]], axis=2)
            for of in kept
        ]
        shares = [of.counts[..., :n_zones] / window for of in kept]
        joined = (np.concatenate(of, axis=1) for of in (shares, errors))
        return cls(runs[0].zone_names, window, *joined)

    @property
    def middles(self) -> NDArray[np.float64]:
        """At which decision each window is at its middle, shape `(W,)`."""
        return np.asarray((np.arange(len(self.errors)) + 0.5) * self.window)

    def shares_in(self, zone: str) -> NDArray[np.float64]:
        """Return the shares of a zone, shape `(W, S)`; none where there is no such zone."""
        return _column(self.shares, self.zone_names, zone)

    def errors_in(self, zone: str) -> NDArray[np.float64]:
        """Return the errors in a zone or `EVERYWHERE`, shape `(W, S)`; none without that zone."""
        return _column(self.errors, (EVERYWHERE, *self.zone_names), zone)

    @property
    def n_decisions(self) -> int:
        """How many decisions there are."""
        return len(self.errors) * self.window


def draw_shares(curves: Mapping[str, Curves]) -> Figure:
    """Return the share of time that robots of each variant spend in each zone, over time."""
    with mpl.rc_context(STYLE):
        figure, panels = _panels(curves, _zones(curves))
        for zone, panel in panels.items():
            shares = {name: of.shares_in(zone) for name, of in curves.items()}
            _draw_lines(panel, curves, shares, PART)
            panel.set_ylim(0, 1)
        first = next(iter(panels.values()))
        first.yaxis.set_major_formatter(PercentFormatter(1.0))
        first.set_ylabel(f"Share of time in {_window(curves)} decisions")
        name_lines(figure, [*panels.values()][-1], _n_columns(curves))
    return figure


def draw_errors(curves: Mapping[str, Curves]) -> Figure:
    """Return the mean error of each variant over time, in all and in each zone.

    On a logarithmic axis, in scaled units. Where an interval reaches 0, its band goes down to the
    edge.
    """
    means = np.concatenate([known_mean(of.errors, axis=1).ravel() for of in curves.values()])
    least = means.min(initial=np.inf, where=means > 0) / 2
    is_logarithmic = np.isfinite(least)
    within = (least, np.inf) if is_logarithmic else POSITIVE
    with mpl.rc_context(STYLE):
        figure, panels = _panels(curves, [EVERYWHERE, *_zones(curves)])
        for zone, panel in panels.items():
            errors = {name: of.errors_in(zone) for name, of in curves.items()}
            _draw_lines(panel, curves, errors, within)
        first = next(iter(panels.values()))
        if is_logarithmic:
            first.set_yscale("log")  # and with it the others
            first.set_ylim(bottom=least)
            plain_errors(first.yaxis)
        first.set_ylabel(f"Mean error in {_window(curves)} decisions (scaled)")
        name_lines(figure, [*panels.values()][-1], _n_columns(curves))
    return figure


def draw_improvements(panels: Mapping[str, Mapping[str, Estimate]]) -> Figure:
    """Return probabilities of improvement and their intervals.

    Args:
        panels: For each measure, and each pair of variants, the probability that the first is
            better.
    """
    pairs = list(dict.fromkeys(pair for of in panels.values() for pair in of))
    n_columns = min(PANELS_A_ROW, len(panels))
    n_rows = -(-len(panels) // n_columns)
    height = n_rows * (0.75 + 0.16 * len(pairs)) + 0.2
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        axes = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False)
        for panel, (title, found) in zip(axes.flat, panels.items(), strict=False):
            _draw_points(panel, pairs, found)
            panel.set_title(title, fontsize=7.5)
        for panel in axes.flat[len(panels) :]:
            panel.set_visible(False)
        for panel in axes.flat[max(0, len(panels) - n_columns) : len(panels)]:
            panel.tick_params(labelbottom=True)
        figure.supxlabel("Probability that the first is better", fontsize=8)
    return figure


def _panels(curves: Mapping[str, Curves], names: Sequence[str]) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure with a panel for each name, side by side, with time along each."""
    n_rows = -(-len(curves) // _n_columns(curves))
    figure = Figure(figsize=(WIDTH, 2.35 + 0.15 * n_rows), layout="constrained")
    axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for panel, name in zip(axes, names, strict=True):
        time_axis(panel, max(of.n_decisions for of in curves.values()), n_ticks=N_TICKS)
        panel.set_title(name, fontsize=8, fontweight="bold")
    return figure, dict(zip(names, axes, strict=True))


def _draw_lines(
    panel: Axes,
    curves: Mapping[str, Curves],
    values: Mapping[str, NDArray[np.float64]],
    within: Range,
) -> None:
    """Draw the mean of each variant's values, shape `(W, S)`, and its interval."""
    for place, (name, of) in enumerate(curves.items()):
        style = line_style(place)
        means = known_mean(values[name], axis=1)
        panel.plot(of.middles, means, linewidth=1.2, label=name, **style)
        low, high = _known_band(values[name], within)
        panel.fill_between(of.middles, low, high, **band_style(style["color"]))


def _known_band(
    values: NDArray[np.float64], within: Range
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the interval of each window's mean over the robots that have one."""
    ends = np.full((2, len(values)), np.nan)
    is_whole = np.isfinite(values).all(axis=1)
    if is_whole.any():
        ends[:, is_whole] = band(values[is_whole], within)
    for window in np.flatnonzero(~is_whole):
        ends[:, window] = band(values[window][np.isfinite(values[window])], within)
    return ends[0], ends[1]


def _draw_points(panel: Axes, pairs: Sequence[str], found: Mapping[str, Estimate]) -> None:
    panel.axvline(0.5, color="#999999", linewidth=0.8, zorder=0)
    for place, pair in enumerate(pairs):
        if pair in found:
            of = found[pair]
            panel.plot([of.low, of.high], [place, place], color=COLOURS[6], linewidth=1.2)
            panel.plot([of.value], [place], "o", color=COLOURS[6], markersize=4, clip_on=False)
    panel.set_yticks(range(len(pairs)), pairs)
    panel.set_ylim(len(pairs) - 0.5, -0.5)
    panel.set_xlim(0, 1)
    panel.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])


def _n_columns(variants: Collection[str]) -> int:
    """Return the number of columns of the legend."""
    longest = max(map(len, variants)) + 6  # with the line before it
    return max(1, min(len(variants), LEGEND_LETTERS // longest))


def _zones(curves: Mapping[str, Curves]) -> list[str]:
    return list(dict.fromkeys(name for of in curves.values() for name in of.zone_names))


def _column(values: NDArray[np.float64], names: Sequence[str], name: str) -> NDArray[np.float64]:
    """Return the values under one of the names along the last axis; NaN if it is not there."""
    if name in names:
        return np.asarray(values[..., names.index(name)])
    return np.full(values.shape[:-1], np.nan)


def _window(curves: Mapping[str, Curves]) -> int:
    return max(of.window for of in curves.values())
