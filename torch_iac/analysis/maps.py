"""Maps of a robot's regions: slices through the space."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from torch_iac.analysis.partition import Partition, partition_of, situation_at
from torch_iac.analysis.style import (
    STYLE,
    WIDE,
    legend,
    zone_colour,
    zone_marker,
)
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import WINDOW

SHADES = LinearSegmentedColormap.from_list("progress", ["#ffffff", "#8c8c8c"])
"""White for no progress; marks in the colours of zones stand out from every shade."""

STAR: dict[str, Any] = {"color": "black", "marker": "*", "markersize": 8, "linestyle": "none"}
DOT: dict[str, Any] = {"markersize": 2, "markeredgewidth": 0, "linestyle": "none"}
"""Marker styles of the decision itself and of those before it."""

PANELS_A_ROW = 3
"""Panels in a row."""

PANEL = 2.3
"""Inches: the height of a row of panels."""


def draw_partition(
    run: Run,
    steps: Sequence[int],
    across: str,
    up: str,
    at: Mapping[str, float] | None = None,
    agent: int = 0,
) -> Figure:
    """Return how a plane of the space was divided when some decisions were chosen, one a panel.

    The darker a region, the more progress the robot made there. A star is the decision itself,
    small marks are the `WINDOW` decisions before it by their zones, wherever they were in the other
    dimensions.

    Args:
        run: The run.
        steps: The decisions.
        across: The plane's horizontal dimension.
        up: Its vertical one.
        at: Other coordinates of the plane, in raw units. Those that are not given are the
            situation's in which the decision was taken.
        agent: Whose space.

    Raises:
        ValueError: There is no such decision, dimension or agent, or a coordinate is out of bounds.
    """
    planes = [_plane(run, step, (across, up), at or {}, agent) for step in steps]
    highest = max(float(plane.progress.max()) for plane in planes)
    shades = ScalarMappable(Normalize(0, highest if highest > 0 else 1), SHADES)
    with mpl.rc_context(STYLE):
        figure, panels = _panels(len(steps))
        for panel, step, plane in zip(panels, steps, planes, strict=True):
            _draw_rectangles(panel, plane, (across, up), shades)
            _draw_decisions(panel, run, step, (across, up), agent)
            panel.set_title(f"decision {step:,}", fontsize=8)
        figure.supxlabel(across, fontsize=8)
        figure.supylabel(up, fontsize=8)
        figure.colorbar(
            shades, ax=panels, label="Learning progress (scaled)", aspect=30, extend="min"
        )
        key = [Line2D([], [], label=name, **_dot(zone)) for zone, name in enumerate(run.zone_names)]
        legend(figure, [*key, Line2D([], [], label="the decision", **STAR)])
    return figure


def _plane(
    run: Run, step: int, axes: tuple[str, str], at: Mapping[str, float], agent: int
) -> Partition:
    """Return the leaves that a plane goes through."""
    point = {**situation_at(run, step, agent), **at}
    others = {name: value for name, value in point.items() if name not in axes}
    return partition_of(run, step, agent).through(others)


def _panels(n_panels: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels, in rows."""
    n_columns = min(PANELS_A_ROW, n_panels)
    n_rows = -(-n_panels // n_columns)
    width = WIDE[0] * (n_columns + 1) / (PANELS_A_ROW + 1)
    figure = Figure(figsize=(width, PANEL * n_rows + 0.5), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    for panel in panels[n_panels:]:
        panel.set_visible(False)
    return figure, panels[:n_panels].tolist()


def _draw_rectangles(
    panel: Axes, plane: Partition, axes: tuple[str, str], shades: ScalarMappable
) -> None:
    """Draw the regions of a plane, and show all of it."""
    (left, right), (bottom, top) = (plane.sides(name) for name in axes)
    for region, progress in enumerate(plane.progress):
        corner, width = (left[region], bottom[region]), right[region] - left[region]
        shade = shades.to_rgba(progress)
        height = top[region] - bottom[region]
        panel.add_patch(
            Rectangle(corner, width, height, facecolor=shade, edgecolor="black", linewidth=0.6)
        )
    panel.spines[:].set_visible(True)
    panel.set_xlim(left.min(), right.max())
    panel.set_ylim(bottom.min(), top.max())


def _draw_decisions(panel: Axes, run: Run, step: int, axes: tuple[str, str], agent: int) -> None:
    """Draw a decision and those before it."""
    actions = {action.name for action in run.space.actions}
    columns = [f"{'action' if name in actions else 'sensor'}/{name}" for name in axes]
    wanted = [*columns, "zone"] if run.zone_names else columns
    recent = run.table(wanted, agent).slice(max(0, step - WINDOW), min(step, WINDOW) + 1)
    points = [recent[column].to_numpy() for column in columns]
    before = np.arange(len(recent) - 1)
    zones = recent["zone"].to_numpy()[before] if run.zone_names else None
    for zone in range(len(run.zone_names)) or [-1]:
        here = before if zones is None else before[zones == zone]
        panel.plot(*(of[here] for of in points), **_dot(zone))
    panel.plot(*(of[-1:] for of in points), clip_on=False, zorder=5, **STAR)


def _dot(zone: int) -> dict[str, Any]:
    """Return the style of the decisions in a zone; of those in a world without zones for -1."""
    return {"color": zone_colour(zone), "marker": zone_marker(zone), **DOT}
