"""Styles: lines that can be told apart in grey, names that do not overlap."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from tests.pictures import alike_in_grey, cut_off, looks_of, overlapping
from torch_iac.analysis import style
from torch_iac.analysis.style import legend, line_style, name_lines, plain_errors, zone_style

GAP = 0.1

StyleOf = Callable[[int], dict[str, Any]]


def lines(n_lines: int, style_of: StyleOf = line_style, names: str = "line {}") -> Figure:
    figure = Figure(figsize=style.SIZE, layout="constrained")
    axes = figure.subplots()
    for place in range(n_lines):
        axes.plot([0, 1], [0, 0.02 * place], label=names.format(place), **style_of(place))
    axes.set_ylim(0, 1)
    return figure


@pytest.mark.parametrize(("style_of", "n_lines"), [(line_style, 8), (zone_style, 6)])
def test_lines_can_be_told_apart_in_grey(style_of: StyleOf, n_lines: int) -> None:
    looks = looks_of(lines(n_lines, style_of))
    assert len(looks) == n_lines
    assert alike_in_grey(looks) == []


def test_colours_alone_can_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zones used to have colours only; in grey, f1 and f3 were the same."""
    monkeypatch.setattr(style, "ZONE_LINES", ("-",))
    assert alike_in_grey(looks_of(lines(3, zone_style)))


def test_names_stand_apart_at_the_ends_of_lines() -> None:
    figure = lines(6)
    name_lines(figure, figure.axes[0])
    assert [text.get_text() for text in figure.axes[0].texts] == [f"line {i}" for i in range(6)]
    assert not figure.legends
    assert overlapping(figure) == []
    assert cut_off(figure) == []


def test_overlapping_names_are_found() -> None:
    figure = lines(2)
    for place in (0.5, 0.51):
        figure.axes[0].text(0.5, place, f"at {place}")
    assert overlapping(figure) == [("at 0.5", "at 0.51")]
    figure.text(0.9, 0.9, "a long text that goes beyond")
    assert cut_off(figure) == ["a long text that goes beyond"]


def test_a_long_name_or_a_line_without_an_end_has_a_legend() -> None:
    long, unfinished = lines(2, names="a name that is long, number {}"), lines(2)
    unfinished.axes[0].plot([], [], label="nothing", **line_style(2))
    for figure in (long, unfinished):
        (axes,) = figure.axes
        name_lines(figure, axes)
        assert not axes.texts
        assert len(figure.legends[0].get_texts()) == len(axes.lines)


@given(st.lists(st.floats(-1, 2), min_size=1, max_size=9))
def test_moved_apart(heights: list[float]) -> None:
    """Names keep their order and a distance, stay where they fit, and are inside."""
    given_heights = np.array(heights)
    moved = style._moved_apart(given_heights, GAP)
    assert np.all(np.diff(np.sort(moved)) >= GAP - 1e-9)
    assert np.argsort(moved).tolist() == np.argsort(given_heights, kind="stable").tolist()
    assert moved.min() >= -1e-9
    assert moved.max() <= 1 + 1e-9
    apart = np.sort(given_heights)
    if apart[0] >= 0 and apart[-1] <= 1 and np.all(np.diff(apart) >= GAP):
        assert moved.tolist() == given_heights.tolist()


@pytest.mark.parametrize(
    ("limits", "written"),
    [
        ((0.004, 0.3), {"0.01", "0.1"}),
        ((0.018, 0.24), {"0.02", "0.05", "0.1", "0.2"}),
        ((0.02, 0.05), {"0.02", "0.03"}),
    ],
)
def test_errors_are_written_plainly(limits: tuple[float, float], written: set[str]) -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.set_yscale("log")
    axes.set_ylim(limits)
    plain_errors(axes.yaxis)
    figure.draw_without_rendering()
    ticks = cast(Any, axes.yaxis)._update_ticks()
    assert written <= {tick.label1.get_text() for tick in ticks}
    assert overlapping(figure) == []
    assert not any("10^" in tick.label1.get_text() for tick in ticks)


def test_text_is_dark_enough() -> None:
    for colour in (*style.COLOURS, *style.ZONE_COLOURS):
        assert np.dot(style._ink(colour), [0.299, 0.587, 0.114]) <= style.LIGHTEST_INK + 1e-6
    assert style._ink("#0072B2") == pytest.approx((0, 0x72 / 255, 0xB2 / 255))


def test_a_legend_is_clear_of_the_axes() -> None:
    figure = lines(3)
    legend(figure, figure.axes[0].lines)
    assert overlapping(figure) == []
