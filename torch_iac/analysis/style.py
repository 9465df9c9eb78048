"""Common style of all figures: colours, sizes, axes, legends, and how they are saved."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

# TensorBoard's pictures have the same colours.
from torch_iac.runs.charts import MIXED_COLOUR as MIXED_COLOUR
from torch_iac.runs.charts import ZONE_COLOURS as ZONE_COLOURS
from torch_iac.runs.charts import zone_colour as zone_colour

COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#0072B2", "#D55E00")
"""Black, orange, sky blue, bluish green, reddish purple, blue, vermillion."""

LINES = ("-", "--", ":", "-.")
"""Line styles, one for each cycle through the colours."""

DPI = 220
"""Dots per inch."""

PANELS_A_ROW = 3
"""Panels in a row where each measure has one."""

EXPERT_COLOURS = ("#000000", "#E69F00", "#56B4E9", "#CC79A7", "#F0E442", "#D55E00")
"""Black, orange, sky blue, reddish purple, yellow, vermillion: the main experts, then shadows."""

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


def legend(figure: Figure, key: Sequence[Artist], n_columns: int | None = None) -> None:
    """Put a legend above the axes, clear of the data; in one row if `n_columns` is not given."""
    figure.legend(
        handles=key,
        loc="outside upper center",
        ncols=n_columns or len(key),
        frameon=False,
        handlelength=2.0,  # shows a dashed line as one
        columnspacing=1.2,
    )


def legend_line(colour: str, label: str) -> Line2D:
    """Return a line for a legend."""
    return Line2D([], [], color=colour, linewidth=1.6, label=label)


def band_style(colour: str) -> dict[str, Any]:
    """Return how an interval around a line is filled."""
    return {"color": colour, "alpha": 0.25, "linewidth": 0}


def expert_colour(place: int) -> str:
    """Return the colour of a kind of experts."""
    return EXPERT_COLOURS[place % len(EXPERT_COLOURS)]
