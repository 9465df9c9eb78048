"""The tree of an agent's regions: errors of its experts (figure 2 of the 2004 paper), cuts."""

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from torch_iac.analysis.region_history import (
    ErrorCurve,
    children_of,
    error_curves,
    region_zones,
)
from torch_iac.analysis.style import (
    LINES,
    MIXED_COLOUR,
    STYLE,
    WIDE,
    legend,
    legend_line,
    name_ends,
    plain_errors,
    time_axis,
    zone_colour,
    zone_style,
)
from torch_iac.runs.followed_regions import LEAST_PURITY
from torch_iac.runs.reader import Run

MAX_POINTS = 400
"""A curve is drawn with at most so many points."""

SIZE = (3.5, 3.0)
"""Inches: of figure 2."""

CUT: dict[str, Any] = {"marker": "o", "color": "black", "linestyle": "none", "markersize": 1.6}
"""Style of the point at which a region is cut in two."""

MOST_NUMBERS = 5
"""So many cuts of the tree are numbered and named, the first ones."""

NUMBER_SIZE = 6
"""Points: the size of their numbers."""

NUMBER: dict[str, Any] = {
    "ha": "center",
    "va": "center",
    "fontsize": NUMBER_SIZE,
    "bbox": {"boxstyle": "circle,pad=0.2", "facecolor": "white", "linewidth": 0.6},
}
"""Style of a number: in a circle which covers the lines behind it."""


def draw_experts(run: Run, agent: int = 0, window: int | None = None) -> Figure:
    """Return figure 2: the tree of an agent's experts, by the mean error of each over time.

    A curve is the mean of the last `window` errors of a region, each error being the mean absolute
    difference (or as the run's config says) between prediction and outcome, in scaled units. It
    lasts from the region's birth to its split, a dot, where the curves of its two children begin.
    These inherit the errors of their parent, so the path from the root to a leaf is that of the
    leaf's expert; a run may be configured to let children begin without errors. Means of fewer
    errors are left out then and in a run that has no others. A curve's colour and dashes are those
    of the zone that it mostly covers; without zones its colour is its depth. The errors are on a
    logarithmic axis.

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
    if run.inherits_history and run.n_decisions > window:
        whole = [curve.of_at_least(window) for curve in curves]
        curves = [curve for curve in whole if len(curve.decisions)] or curves
    styles, key = region_styles(run, agent)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE, layout="constrained")
        axes = figure.subplots()
        time_axis(axes, run.n_decisions)
        axes.add_collection(
            _lines(
                [_points(curve) for curve in curves],
                [styles[curve.region] for curve in curves],
                linewidths=1.0 if len(curves) < 60 else 0.7,
            )
        )
        _show_errors(axes, np.concatenate([curve.mean_errors for curve in curves]))
        _draw_cuts(axes, run, curves, agent)
        axes.set_ylabel(f"Mean of last {window} errors (scaled)")
        named = _name_leaves(axes, run, curves, agent) if run.zone_names else []
        cut = Line2D([], [], label="cut", **CUT)
        others = [legend_line(of, name) for name, of in key.items() if name not in named]
        legend(figure, [*others, cut])
    return figure


def draw_tree(run: Run, agent: int = 0) -> Figure:
    """Return a drawing of the tree of regions, from left to right in time.

    A region is a line from its birth to its split or the end of the run; where it splits, what lies
    below the cut goes down. Colours and dashes are those of figure 2. The first cuts are numbered,
    and named above.

    Args:
        run: The run.
        agent: Whose regions.

    Raises:
        ValueError: There is no such agent, or its steps are not recorded.
    """
    family = run.family(agent).to_pylist()
    heights = _heights(family)
    styles, key = region_styles(run, agent)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDE[0], 3.6), layout="constrained")
        axes = figure.subplots()
        time_axis(axes, run.n_decisions)
        lives = [
            np.array([(row["born_step"], height), (_end(row, run), height)])
            for row, height in zip(family, heights, strict=True)
        ]
        axes.add_collection(_lines(lives, styles, linewidths=1.2))
        axes.set_ylim(-1, max(heights) + 1)
        axes.yaxis.set_visible(False)
        axes.spines["left"].set_visible(False)
        _draw_splits(axes, family, heights)
        _number_cuts(axes, family, heights)
        legend(figure, [legend_line(of, name) for name, of in key.items()])
    return figure


def region_styles(
    run: Run, agent: int = 0
) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Return the colour and the dashes of each region's line, and what they mean.

    They are those of the zone which the region mostly covers, or the colour is that of its depth in
    a world without zones.

    Raises:
        ValueError: There is no such agent, or, in a world with zones, its steps are not recorded.
    """
    return _zone_styles(run, agent) if run.zone_names else _depth_styles(run, agent)


def _zone_styles(run: Run, agent: int) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    key = {name: zone_style(zone) for zone, name in enumerate(run.zone_names)}
    styles = [zone_style(zone) for zone in _zones(run, agent)]
    return styles, {**key, "several zones": zone_style(-1)}


def _zones(run: Run, agent: int) -> NDArray[np.int64]:
    """Return the zone that each region covers, shape `(R,)`; -1 for a region of several zones.

    A region that has not predicted yet has its parent's.
    """
    cover = region_zones(run, agent)
    zones = np.where(cover.purity >= LEAST_PURITY, cover.zone, -1)
    parents = run.family(agent)["parent"].to_numpy()
    for region in np.flatnonzero(cover.zone < 0):  # parents come before children
        zones[region] = zones[parents[region]] if parents[region] >= 0 else -1
    return zones


def _depth_styles(run: Run, agent: int) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Return the style of each region by its depth in the tree, and what colours mean."""
    depths = run.family(agent)["depth"].to_numpy()
    deepest = max(1, int(depths.max()))
    shade = [to_hex(mpl.colormaps["viridis"](0.9 * d / deepest)) for d in range(deepest + 1)]
    style = [{"color": colour, "linestyle": LINES[0]} for colour in shade]
    shown = sorted({0, deepest // 2, deepest})
    return [style[depth] for depth in depths], {f"depth {d}": style[d] for d in shown}


def _lines(
    points: Sequence[NDArray[np.float64]], styles: Sequence[Mapping[str, Any]], linewidths: float
) -> LineCollection:
    return LineCollection(
        points,
        colors=[style["color"] for style in styles],
        linestyles=[style["linestyle"] for style in styles],
        linewidths=linewidths,
    )


def _points(curve: ErrorCurve) -> NDArray[np.float64]:
    """Return the points of a curve, shape `(P, 2)`, thinned out if there are too many."""
    n_points = len(curve.decisions)
    kept = np.unique(np.linspace(0, n_points - 1, min(n_points, MAX_POINTS)).round().astype(int))
    return np.stack([curve.decisions[kept], curve.mean_errors[kept]], axis=1)


def _show_errors(axes: Axes, errors: NDArray[np.float64]) -> None:
    """Make the vertical axis logarithmic, as long as the errors; those of 0 are below it."""
    shown = errors[errors > 0]
    if len(shown):
        axes.set_yscale("log")
        axes.set_ylim(shown.min() / 1.2, shown.max() * 1.2)
        plain_errors(axes.yaxis)


def _draw_cuts(axes: Axes, run: Run, curves: Sequence[ErrorCurve], agent: int) -> None:
    """Draw a dot where a curve ends because its region is cut."""
    splits = run.family(agent)["split_step"].to_numpy()
    ends = [_points(curve)[-1] for curve in curves if splits[curve.region] >= 0]
    axes.plot(*np.reshape(ends, (-1, 2)).T, **CUT)


def _name_leaves(axes: Axes, run: Run, curves: Sequence[ErrorCurve], agent: int) -> list[str]:
    """Write the name of each zone beside its leaves, at the median error; return those names."""
    splits, zones = run.family(agent)["split_step"].to_numpy(), _zones(run, agent)
    ends: dict[int, list[float]] = {}
    for curve in curves:
        zone, error = int(zones[curve.region]), float(curve.mean_errors[-1])
        if splits[curve.region] < 0 <= zone and error > 0:
            ends.setdefault(zone, []).append(error)
    names = {run.zone_names[zone]: float(np.median(of)) for zone, of in ends.items()}
    if names:
        name_ends(axes, names, [zone_colour(zone) for zone in ends])
    return list(names)


def _heights(family: Sequence[Mapping[str, Any]]) -> list[float]:
    """Return where regions are drawn: leaves in order of their cuts, parents between children."""
    children = children_of(family)
    heights = [0.0] * len(family)
    to_visit, n_leaves = [0], 0
    while to_visit:  # what lies below a cut first
        region = to_visit.pop()
        if region in children:
            to_visit += reversed(children[region])
        else:
            heights[region], n_leaves = n_leaves, n_leaves + 1
    for row in reversed(family):  # children come after their parents
        if row["region"] in children:
            heights[row["region"]] = float(np.mean([heights[c] for c in children[row["region"]]]))
    return heights


def _end(row: Mapping[str, Any], run: Run) -> int:
    return int(row["split_step"]) if row["split_step"] >= 0 else run.n_decisions


def _draw_splits(axes: Axes, family: Sequence[Mapping[str, Any]], heights: Sequence[float]) -> None:
    """Draw lines from parents to children."""
    splits = [
        [(row["born_step"], heights[row["parent"]]), (row["born_step"], heights[row["region"]])]
        for row in family[1:]
    ]
    axes.add_collection(LineCollection(splits, colors=MIXED_COLOUR, linewidths=0.6, zorder=0))


def _number_cuts(axes: Axes, family: Sequence[Mapping[str, Any]], heights: Sequence[float]) -> None:
    """Number the first cuts, and name them above the axes."""
    cuts = sorted((row for row in family if row["split_step"] >= 0), key=itemgetter("split_step"))
    for number, row in enumerate(cuts[:MOST_NUMBERS], 1):
        axes.text(row["split_step"], heights[row["region"]], str(number), **NUMBER)
    named = [
        f"{number}: {row['cut_dimension']} at {row['cut_value']:.2f}"
        for number, row in enumerate(cuts[:MOST_NUMBERS], 1)
    ]
    axes.set_title("    ".join(named), fontsize=7)
