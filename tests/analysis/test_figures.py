"""The pictures of a run."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from tests.pictures import alike_in_grey, cut_off, looks_of, overlapping
from tests.synthetic_run import write_run
from torch_iac.analysis import figures
from torch_iac.analysis.figures import (
    draw_calibration,
    draw_errors,
    draw_zones,
    save_figures,
)
from torch_iac.analysis.intervals import PART, band
from torch_iac.analysis.style import COLOURS, ZONE_COLOURS
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.statistics import calibration, known_mean, zone_errors, zone_shares


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of four agents."""
    return load_run(write_run(tmp_path_factory.mktemp("run"), n_agents=4, n_decisions=1300))


@pytest.fixture(scope="module")
def compared_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of two agents with two shadows and MP."""
    folder = tmp_path_factory.mktemp("compared")
    return load_run(write_run(folder, 2, 700, shadows={"knn": 2.0, "mlp": 0.5}, meta=True))


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def names(figure: Figure) -> list[str]:
    """Return the names at the ends of the last panel's lines."""
    return [text.get_text() for text in figure.axes[-1].texts]


def test_shares_are_drawn_as_means_over_agents(run: Run) -> None:
    figure = draw_zones(run, window=100)
    lines = figure.axes[0].lines
    assert names(figure) == ["f1", "f2", "f3"]
    assert labels(figure) == ["95 % CI of the mean, 4 agents"]
    for zone, line in enumerate(lines):
        assert_allclose(np.asarray(line.get_xdata()), np.arange(13) * 100 + 50)
        assert_allclose(
            np.asarray(line.get_ydata()), zone_shares(run, 100)[:, :, zone].mean(axis=1)
        )


def test_the_band_is_the_interval_of_the_mean(run: Run) -> None:
    figure = draw_zones(run, window=100)
    for zone, found in enumerate(figure.axes[0].collections):
        low, high = band(zone_shares(run, 100)[:, :, zone], PART)
        (path,) = found.get_paths()
        vertices = np.asarray(path.vertices)
        for place, middle in enumerate(np.arange(13) * 100 + 50):
            ends = vertices[vertices[:, 0] == middle, 1]
            assert_allclose((ends.min(), ends.max()), (low[place], high[place]))


def test_one_agent_has_no_band_and_no_legend(tmp_path: Path) -> None:
    figure = draw_zones(load_run(write_run(tmp_path, n_decisions=30)))
    assert names(figure) == ["f1", "f2", "f3"]
    assert not figure.legends
    middles = np.asarray(figure.axes[0].lines[0].get_xdata())
    assert middles.tolist() == [15.0]  # the run is its only window


def test_errors_of_experts_and_shadows_are_drawn_zone_by_zone(compared_run: Run) -> None:
    figure = draw_errors(compared_run, window=100)
    assert names(figure) == ["main experts", "knn", "mlp"]
    assert [axes.get_title() for axes in figure.axes] == ["f1", "f2", "f3"]
    for zone, axes in enumerate(figure.axes):
        main, knn, mlp = (np.asarray(line.get_ydata()) for line in axes.lines)
        expected = known_mean(zone_errors(compared_run, window=100)[:, :, zone], axis=1)
        assert_allclose(main, expected)
        assert_allclose(knn, 2 * main)
        assert_allclose(mlp, main / 2)
        assert [line.get_color() for line in axes.lines] == list(COLOURS[:3])
        assert_allclose(np.asarray(axes.lines[0].get_xdata()), np.arange(7) * 100 + 50)


def test_errors_have_logarithmic_axes_unless_there_are_none(
    compared_run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert {axes.get_yscale() for axes in draw_errors(compared_run).axes} == {"log"}
    monkeypatch.setattr(figures, "zone_errors", lambda *_: np.zeros((2, 1, 3)))
    assert {axes.get_yscale() for axes in draw_errors(compared_run).axes} == {"linear"}


def test_without_zones_errors_have_one_panel(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=30, zone_names=None, shadows={"knn": 2.0})
    (axes,) = draw_errors(load_run(folder)).axes
    errors = load_run(folder).column("error")
    assert_allclose(np.asarray(axes.lines[0].get_ydata()), [errors.mean()])


def test_calibration_is_drawn_by_decile_and_by_zone(compared_run: Run) -> None:
    axes, found = draw_calibration(compared_run).axes[0], calibration(compared_run)
    deciles, *zones = axes.lines[1:]  # the diagonal comes first
    assert_allclose(np.asarray(deciles.get_xdata()), found.expected)
    assert_allclose(np.asarray(deciles.get_ydata()), found.actual)
    assert [text.get_text() for text in axes.texts] == ["f1", "f2", "f3"]
    for zone, marker in enumerate(zones):
        of = found.zones[f"f{zone + 1}"]
        assert np.asarray(marker.get_xydata()).tolist() == [[of.expected, of.actual]]
        assert marker.get_color() == ZONE_COLOURS[zone]
    assert axes.get_xlim() == axes.get_ylim()


def test_figures_are_saved_as_there_is_something_to_show(compared_run: Run) -> None:
    saved = [path.stem for path in save_figures(compared_run.folder)]
    assert saved == ["experts", "tree", "zones", "errors", "calibration"]


def test_a_run_of_one_decision_can_be_drawn(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=1, shadows={"knn": 2.0}, meta=True)
    assert len(save_figures(folder)) == 5


def test_figures_are_saved_beside_the_run(run: Run) -> None:
    paths = save_figures(run.folder, pdf=True)
    assert [path.name for path in paths] == [
        "experts.png",
        "experts.pdf",
        "tree.png",
        "tree.pdf",
        "zones.png",
        "zones.pdf",
    ]
    assert {path.read_bytes()[:4] for path in paths} == {b"\x89PNG", b"%PDF"}
    assert {path.parent for path in paths} == {run.folder / "figures"}


def test_a_world_without_zones_has_trees_only(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=10, zone_names=None)
    assert [path.name for path in save_figures(folder)] == ["experts.png", "tree.png"]
    with pytest.raises(ValueError, match="has no zones"):
        draw_zones(load_run(folder))


def test_figures_can_be_read(run: Run, compared_run: Run) -> None:
    for figure in (draw_zones(run), draw_errors(compared_run), draw_calibration(compared_run)):
        assert overlapping(figure) == []
        assert cut_off(figure) == []
        looks = looks_of(figure)
        assert len(looks) >= 3
        assert alike_in_grey(looks) == []
