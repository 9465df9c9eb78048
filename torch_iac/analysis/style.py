"""Common style of all figures: colours, lines, sizes, axes, names, and how they are saved.

Colours are Okabe and Ito's, which colour-blind readers tell apart. Lines differ in their dashes
too, so that they can be told apart in grey, and have their names at their ends if there is room.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

# TensorBoard's pictures have the same colours.
from torch_iac.runs.charts import MIXED_COLOUR as MIXED_COLOUR
from torch_iac.runs.charts import ZONE_COLOURS as ZONE_COLOURS
from torch_iac.runs.charts import zone_colour as zone_colour

COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#D55E00", "#0072B2")
"""Black, orange, sky blue, bluish green, reddish purple, vermillion, blue."""

LINES = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (5, 1.4, 1.2, 1.4)))
"""Solid, dashed, dotted, dash and dot: line after line, as the colours go on."""

DPI = 220
"""Dots per inch."""

PANELS_A_ROW = 3
"""Panels in a row where each measure has one."""

ZONE_LINES = (LINES[1], LINES[0], LINES[2], LINES[3])
"""Dashed, solid, dotted, dash and dot."""

ZONE_MARKERS = ("s", "o", "^", "D", "v", "X")
"""Square, circle, triangle, diamond, triangle upside down, cross."""

NAME_SIZE = 7
"""Points: the size of the names at lines' ends."""

NAME_LETTERS = 16
"""Longer names are in a legend, not at lines' ends."""

LIGHTEST_INK = 0.45
"""Text is at most so light, as a grey between black, 0, and white, 1."""

LINE_SPACING = 1.4
"""How far apart names stand, at least, as a multiple of their size."""

SIZE = (3.5, 2.6)
"""Inches: one column of a paper."""

WIDE = (7.0, 2.4)
"""Inches: the whole width of a page."""

STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "pdf.fonttype": 42,  # text stays text
}
"""Matplotlib's settings for all figures."""


def save(figure: Figure, path: Path) -> None:
    """Write a picture."""
    with mpl.rc_context(STYLE):
        figure.savefig(path, dpi=DPI)


def time_axis(axes: Axes, n_decisions: int, n_ticks: int = 5) -> None:
    """Make the horizontal axis of a panel time."""
    axes.set_xlim(0, n_decisions)
    axes.xaxis.set_major_locator(MaxNLocator(n_ticks, steps=[1, 2, 5, 10], integer=True))
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.set_xlabel("Decisions")


def plain_errors(axis: Axis) -> None:
    """Write the errors along a logarithmic axis plainly, as 0.01.

    On an axis of few powers of ten also twice and five times these, on a short one all.
    """

    def between(error: float, _: float) -> str:
        low, high = axis.get_view_interval()
        written = f"{error:g}"
        is_shown = high < 3 * low or (high < 30 * low and written[-1] in "25")
        return written if is_shown else ""

    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(between)


def legend(figure: Figure, key: Sequence[Artist], n_columns: int | None = None) -> None:
    """Put a legend above the axes, clear of the data; in one row if `n_columns` is not given."""
    figure.legend(
        handles=key,
        loc="outside upper center",
        ncols=n_columns or len(key),
        frameon=False,
        handlelength=2.6,  # shows of which dashes a line is
        columnspacing=1.2,
    )


def legend_line(style: Mapping[str, Any], label: str) -> Line2D:
    """Return a line for a legend."""
    return Line2D([], [], linewidth=1.6, label=label, **style)


def name_lines(figure: Figure, axes: Axes, n_columns: int | None = None) -> None:
    """Name labelled lines at their ends.

    If a name is long, or a line has no points in these axes, there is a legend instead.

    Args:
        figure: The figure.
        axes: Where the lines are, if there are several the last ones of a row.
        n_columns: Of the legend; one row if it is not given.
    """
    ends = {str(line.get_label()): _end(line) for line in axes.lines}
    if max(map(len, ends)) <= NAME_LETTERS and np.isfinite(list(ends.values())).all():
        name_ends(axes, ends, [str(line.get_color()) for line in axes.lines])
    else:
        legend(figure, axes.lines, n_columns)


def _end(line: Line2D) -> float:
    """Return the height at which a line ends; NaN if it has no points."""
    heights = np.asarray(line.get_ydata(), float)
    known = heights[np.isfinite(heights)]
    return float(known[-1]) if len(known) else np.nan


def name_ends(
    axes: Axes,
    ends: Mapping[str, float],
    colours: Sequence[str],
    size: float = NAME_SIZE,
) -> None:
    """Write the names of lines to the right of the axes, at the heights where the lines end.

    Names that would overlap are moved apart.

    Args:
        axes: The axes, with the vertical limits that they are to have.
        ends: Under each name, where its line ends, in units of the vertical axis.
        colours: Of the names.
        size: Their size, in points.
    """
    points = axes.transData.transform([(0.0, end) for end in ends.values()])
    heights = axes.transAxes.inverted().transform(points)[:, 1]
    inches = axes.get_position().height * axes.get_figure(root=True).get_figheight()  # type: ignore[union-attr]
    places = _moved_apart(heights, LINE_SPACING * size / 72 / inches)
    for name, place, colour in zip(ends, places, colours, strict=True):
        axes.annotate(
            name,
            (1, place),
            (5, 0),
            xycoords="axes fraction",
            textcoords="offset points",
            color=_ink(colour),
            fontsize=size,
            fontweight="bold",
            va="center",
            annotation_clip=False,
        )


def _ink(colour: str) -> tuple[float, float, float]:
    """Return a colour dark enough for text."""
    red, green, blue = to_rgb(colour)
    darker = min(1.0, LIGHTEST_INK / (0.299 * red + 0.587 * green + 0.114 * blue + 1e-9))
    return red * darker, green * darker, blue * darker


def _moved_apart(heights: NDArray[np.float64], gap: float) -> NDArray[np.float64]:
    """Return heights in the same order, in [0, 1] if they fit, at least so far apart."""
    order = np.argsort(heights, kind="stable")
    places = np.clip(heights[order], 0, 1)
    for i in range(1, len(places)):
        places[i] = max(places[i], places[i - 1] + gap)
    highest = 1.0
    for i in reversed(range(len(places))):
        places[i] = highest = min(places[i], highest)
        highest -= gap
    moved = np.empty_like(places)
    moved[order] = places
    return moved


def band_style(colour: str) -> dict[str, Any]:
    """Return how an interval around a line is filled."""
    return {"color": colour, "alpha": 0.25, "linewidth": 0}


def line_style(place: int) -> dict[str, Any]:
    """Return the colour and the dashes of a line: of a variant, or of a kind of experts."""
    return {"color": COLOURS[place % len(COLOURS)], "linestyle": LINES[place % len(LINES)]}


def zone_style(zone: int) -> dict[str, Any]:
    """Return the colour and the dashes of a zone's line; of what covers no zone for -1."""
    if zone < 0:
        return {"color": MIXED_COLOUR, "linestyle": LINES[0]}
    return {"color": zone_colour(zone), "linestyle": ZONE_LINES[zone % len(ZONE_LINES)]}


def zone_marker(zone: int) -> str:
    """Return the marker of points in a zone; in a world without zones for -1."""
    return ZONE_MARKERS[zone % len(ZONE_MARKERS)] if zone >= 0 else "o"
