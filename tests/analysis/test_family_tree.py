"""The tree of regions: figure 2 and the drawing of the cuts show what the run holds."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgba_array
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from tests.pictures import alike_in_grey, cut_off, looks_of, overlapping
from tests.synthetic_run import write_run
from torch_iac.analysis import family_tree
from torch_iac.analysis.family_tree import MOST_NUMBERS, draw_experts, draw_tree
from torch_iac.analysis.region_history import error_curves, region_zones
from torch_iac.analysis.style import MIXED_COLOUR, ZONE_COLOURS
from torch_iac.runs.reader import Run, load_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of two agents."""
    return load_run(write_run(tmp_path_factory.mktemp("run"), n_agents=2, n_decisions=1300))


@pytest.fixture(scope="module")
def no_zones(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run in a world without zones."""
    return load_run(write_run(tmp_path_factory.mktemp("plain"), n_decisions=700, zone_names=None))


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def curves_of(figure: Figure) -> LineCollection:
    lines = figure.axes[0].collections[0]
    assert isinstance(lines, LineCollection)
    return lines


def colours_of(lines: LineCollection) -> list[str]:
    return [to_hex(colour).upper() for colour in to_rgba_array(lines.get_colors())]


def test_figure_2_has_a_curve_for_each_expert_in_the_colour_of_its_zone(run: Run) -> None:
    figure = draw_experts(run, agent=1)
    lines, curves, cover = curves_of(figure), error_curves(run, 1), region_zones(run, 1)
    assert len(lines.get_segments()) == len(curves)
    assert labels(figure) == ["several zones", "cut"]
    for curve, segment, colour in zip(curves, lines.get_segments(), colours_of(lines), strict=True):
        assert_allclose(segment[-1], [curve.decisions[-1], curve.mean_errors[-1]])
        if cover.purity[curve.region] == 1.0:
            assert colour == ZONE_COLOURS[cover.zone[curve.region]]


def test_means_of_fewer_errors_than_the_window_do_not_set_the_scale(run: Run) -> None:
    """The first error alone may be ten times as large as any mean of 150."""
    (axes,) = draw_experts(run).axes
    root = curves_of(draw_experts(run)).get_segments()[0]
    assert root[0][0] == run.error_window - 1
    errors = run.table(["error"], 0)["error"].to_numpy()
    assert root[0][1] == pytest.approx(errors[: run.error_window].mean())
    shown = np.concatenate([s[:, 1] for s in curves_of(draw_experts(run)).get_segments()])
    assert axes.get_yscale() == "log"
    assert_allclose(axes.get_ylim(), [shown.min() / 1.2, shown.max() * 1.2], rtol=0.02)


def test_a_run_shorter_than_the_window_shows_the_means_that_there_are(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path, n_decisions=30))
    (segment,) = curves_of(draw_experts(run)).get_segments()
    assert segment[0][0] == 0
    assert draw_experts(run).axes[0].get_ylabel() == "Mean of last 150 errors (scaled)"


def test_errors_of_zero_can_be_drawn(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    curves = error_curves(run)
    for curve in curves:
        curve.mean_errors[:] = 0
    monkeypatch.setattr(family_tree, "error_curves", lambda *_: curves)
    assert draw_experts(run).axes[0].get_yscale() == "linear"


def test_a_path_goes_on_from_its_parent_with_a_dot_where_it_was_cut(run: Run) -> None:
    figure = draw_experts(run)
    curves, family = error_curves(run), run.family().to_pylist()
    ends = {curve.region: (curve.decisions[-1], curve.mean_errors[-1]) for curve in curves}
    for curve in curves[1:]:
        start = (curve.decisions[0], curve.mean_errors[0])
        assert_allclose(start, ends[family[curve.region]["parent"]])
    (dots,) = figure.axes[0].lines
    cut = [ends[row["region"]] for row in family if row["split_step"] >= 0]
    assert_allclose(np.asarray(dots.get_xydata()), cut)


def test_each_zone_is_named_beside_its_leaves(run: Run) -> None:
    (axes,) = draw_experts(run).axes
    names = sorted(axes.texts, key=lambda text: -text.xy[1])  # type: ignore[attr-defined]
    assert [text.get_text() for text in names] == ["f1", "f2", "f3"]


def test_the_root_hears_every_zone_and_has_the_colour_of_none(run: Run) -> None:
    assert colours_of(curves_of(draw_experts(run)))[0] == MIXED_COLOUR


def test_a_region_that_has_not_predicted_yet_has_its_parents_colour(run: Run) -> None:
    styles, _ = family_tree.region_styles(run)
    cover, parents = region_zones(run), run.family()["parent"].to_pylist()
    for region in np.flatnonzero(cover.zone < 0):
        assert styles[region] == styles[parents[region]]


def test_the_figure_says_over_how_many_errors_the_run_took_its_means(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=30, numbers={"window": 26})
    figure = draw_experts(load_run(folder))
    assert figure.axes[0].get_ylabel() == "Mean of last 26 errors (scaled)"


def test_without_zones_experts_are_coloured_by_depth(no_zones: Run) -> None:
    assert labels(draw_experts(no_zones))[:2] == ["depth 0", "depth 1"]
    assert draw_tree(no_zones).legends


def test_long_curves_are_thinned_out(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(family_tree, "MAX_POINTS", 10)
    assert max(len(segment) for segment in curves_of(draw_experts(run)).get_segments()) == 10


def test_the_tree_has_a_line_for_each_region_from_birth_to_split(run: Run) -> None:
    family = run.family().to_pylist()
    segments = np.array(curves_of(draw_tree(run)).get_segments())
    ends = [row["split_step"] if row["split_step"] >= 0 else 1300 for row in family]
    assert segments[:, 0, 0].tolist() == [row["born_step"] for row in family]
    assert segments[:, 1, 0].tolist() == ends
    heights = segments[:, 0, 1]
    leaves = sorted(heights[i] for i, row in enumerate(family) if row["split_step"] < 0)
    assert leaves == list(range(len(leaves)))


def test_below_in_the_tree_is_below_the_cut(run: Run) -> None:
    """The first cut is at 2/3 of the sound: what comes of the child above it is drawn higher."""
    family = run.family().to_pylist()
    heights = np.array(curves_of(draw_tree(run)).get_segments())[:, 0, 1]
    root, below, above = heights[:3]
    assert below < root < above
    assert root == (below + above) / 2
    assert [row["parent"] for row in family[:3]] == [-1, 0, 0]


def test_the_tree_numbers_its_first_cuts_and_names_them(run: Run) -> None:
    (axes,) = draw_tree(run).axes
    cuts = sorted(row["split_step"] for row in run.family().to_pylist() if row["split_step"] >= 0)
    assert [text.get_text() for text in axes.texts] == [str(n + 1) for n in range(MOST_NUMBERS)]
    assert [text.get_position()[0] for text in axes.texts] == cuts[:MOST_NUMBERS]
    assert axes.get_title().startswith("1: sound at 0.67")


def test_trees_can_be_read(run: Run, no_zones: Run) -> None:
    for figure in (draw_experts(run), draw_tree(run), draw_experts(no_zones), draw_tree(no_zones)):
        assert overlapping(figure) == []
        assert cut_off(figure) == []
    for figure in (draw_experts(run), draw_tree(run)):
        looks = looks_of(figure)
        assert len(looks) >= 4
        assert alike_in_grey(looks) == []
