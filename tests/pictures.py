"""What a reader of a figure needs: lines that differ in grey, texts that do not overlap."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from numpy.typing import NDArray

LEAST_DIFFERENCE = 0.1
"""Mean difference between the pixels of two lines in grey, from black, 0, to white, 1."""

Look = tuple[Any, ...]
"""A colour, a pattern of dashes and a marker."""


def looks_of(figure: Figure) -> list[Look]:
    """Return the different looks of the lines that a figure draws in its axes or its legends."""
    looks: dict[Look, None] = {}
    for axes in figure.axes:
        for line in axes.lines:
            looks[_look(line)] = None
        for lines in axes.collections:
            if isinstance(lines, LineCollection):
                colours = [to_hex(colour) for colour in to_rgba_array(lines.get_colors())]
                dashes = [_dashes(of) for of in lines.get_linestyle()]
                n = max(len(colours), len(dashes))
                pairs = zip((colours * n)[:n], (dashes * n)[:n], strict=True)
                looks |= {(colour, of, "None"): None for colour, of in pairs}
    return list(looks)


def alike_in_grey(looks: list[Look]) -> list[tuple[Look, Look]]:
    """Return the pairs of looks, of the same marker, that can hardly be told apart in grey."""
    greys = [_greys(look) for look in looks]
    return [
        (looks[i], looks[j])
        for i, j in combinations(range(len(looks)), 2)
        if looks[i][2] == looks[j][2] and np.abs(greys[i] - greys[j]).mean() < LEAST_DIFFERENCE
    ]


def overlapping(figure: Figure) -> list[tuple[str, str]]:
    """Return the pairs of texts that overlap in a figure as it is drawn."""
    FigureCanvasAgg(figure).draw()  # type: ignore[no-untyped-call]
    texts = list(_texts(figure))
    boxes = [text.get_window_extent().padded(-0.5) for text in texts]
    return [
        (texts[i].get_text(), texts[j].get_text())
        for i, j in combinations(range(len(texts)), 2)
        if boxes[i].overlaps(boxes[j])
    ]


def cut_off(figure: Figure) -> list[str]:
    """Return the texts that are not wholly on a figure as it is drawn."""
    FigureCanvasAgg(figure).draw()  # type: ignore[no-untyped-call]
    page = figure.bbox.padded(1)
    return [
        text.get_text()
        for text in _texts(figure)
        if not np.all([page.contains(*corner) for corner in text.get_window_extent().corners()])
    ]


def _texts(figure: Figure) -> Iterator[Text]:
    """Yield all texts that are drawn."""
    found = [*figure.texts, *(text for legend in figure.legends for text in legend.get_texts())]
    found += filter(None, (figure._supxlabel, figure._supylabel))  # type: ignore[attr-defined]
    for axes in figure.axes:
        if axes.get_visible():
            found += [*axes.texts, axes.title]
            for axis in (axes.xaxis, axes.yaxis):
                if axis.get_visible():
                    found.append(axis.label)
                    ticks = cast(Any, axis)._update_ticks()
                    found += [tick.label1 for tick in ticks if tick.label1.get_visible()]
    return (text for text in dict.fromkeys(found) if text.get_visible() and text.get_text().strip())


def _look(line: Line2D) -> Look:
    return line.get_color(), _dashes(line._dash_pattern), str(line.get_marker())  # type: ignore[attr-defined]


def _dashes(pattern: Any) -> tuple[float, tuple[float, ...] | None]:
    """Return a pattern of dashes as it is for a line of one point's width."""
    offset, lengths = pattern
    return offset, None if lengths is None else tuple(lengths)


def _greys(look: Look) -> NDArray[np.float64]:
    """Return a line in grey, pixel by pixel from left to right."""
    colour, (offset, lengths), marker = look
    figure = Figure(figsize=(1.0, 0.2), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    dashes: Any = (offset, lengths) if lengths else "-"
    axes.plot([0, 1], [0.5, 0.5], color=colour, linestyle=dashes, linewidth=3, marker=marker)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba())[10, :, :3] / 255  # type: ignore[no-untyped-call]
    return np.asarray(pixels @ [0.299, 0.587, 0.114])
