"""Maps of regions: what is drawn is what the run holds."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.testing import assert_allclose

from tests.pictures import cut_off, overlapping
from tests.synthetic_run import ZONES, write_run
from torch_iac.analysis.maps import draw_partition
from torch_iac.analysis.partition import partition_of, situation_at
from torch_iac.analysis.style import MIXED_COLOUR, ZONE_COLOURS, ZONE_MARKERS
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.schema import WINDOW

PLANE = ("sound", "left_wheel")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of two agents."""
    return load_run(write_run(tmp_path_factory.mktemp("run"), n_agents=2, n_decisions=1300))


def points(line: Line2D) -> np.ndarray:
    return np.asarray(line.get_xydata())


def rectangles_of(run: Run, step: int, at: dict[str, float]) -> list[Rectangle]:
    (panel, _) = draw_partition(run, [step], *PLANE, at=at).axes
    return [patch for patch in panel.patches if isinstance(patch, Rectangle)]


def test_the_regions_of_a_plane_fill_it_darker_where_progress_is_higher(run: Run) -> None:
    at = {"beam": 1.0, "toy_distance": 2.0}
    rectangles = rectangles_of(run, 1200, at)
    assert sum(of.get_width() * of.get_height() for of in rectangles) == pytest.approx(2.0)
    progress = partition_of(run, 1200).through(at).progress
    darkness = [-sum(to_rgb(of.get_facecolor())) for of in rectangles]
    known = progress > 0
    assert known.sum() > 1
    assert np.argsort(progress[known]).tolist() == np.argsort(np.array(darkness)[known]).tolist()
    assert {to_hex(rectangles[i].get_facecolor()) for i in np.flatnonzero(~known)} <= {"#ffffff"}


def test_the_plane_goes_through_the_situation_unless_told_otherwise(run: Run) -> None:
    situation = situation_at(run, 1200)
    others = {name: situation[name] for name in ("beam", "toy_distance")}
    told, untold = rectangles_of(run, 1200, others), rectangles_of(run, 1200, {})
    assert [of.get_bbox().bounds for of in told] == [of.get_bbox().bounds for of in untold]


def test_a_panel_shows_the_decision_and_those_before_it_by_zone(run: Run) -> None:
    step = 700
    panel = draw_partition(run, [0, step], *PLANE, agent=1).axes[1]
    *dots, star = panel.lines
    assert panel.get_title() == "decision 700"
    assert_allclose(points(star), [[run.column(f"action/{d}")[step, 1] for d in PLANE]])
    zones = run.column("zone")[step - WINDOW : step, 1]
    assert [len(points(of)) for of in dots] == np.bincount(zones, minlength=3).tolist()
    assert [of.get_color() for of in dots] == list(ZONE_COLOURS[:3])
    assert [of.get_marker() for of in dots] == list(ZONE_MARKERS[:3])
    assert sorted(np.concatenate([points(of)[:, 0] for of in dots])) == sorted(
        run.column("action/sound")[step - WINDOW : step, 1]
    )


def test_the_first_decision_has_none_before_it(run: Run) -> None:
    figure = draw_partition(run, [0], *PLANE)
    *dots, star = figure.axes[0].lines
    assert [len(points(of)) for of in (*dots, star)] == [0, 0, 0, 1]
    key = [text.get_text() for text in figure.legends[0].get_texts()]
    assert key == [*ZONES, "the decision"]


def test_panels_stand_in_rows_of_three(run: Run) -> None:
    figure = draw_partition(run, [0, 300, 600, 900], *PLANE)
    titles = [axes.get_title() for axes in figure.axes if axes.get_visible()]
    assert titles == ["decision 0", "decision 300", "decision 600", "decision 900", ""]


def test_a_map_can_be_read(run: Run) -> None:
    figure = draw_partition(run, [0, 300, 600, 900], *PLANE)
    assert overlapping(figure) == []
    assert cut_off(figure) == []


def test_without_zones_there_are_maps_too(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path, n_decisions=600, zone_names=None))
    dots = draw_partition(run, [500], *PLANE).axes[0].lines[0]
    assert dots.get_color() == MIXED_COLOUR
    assert len(points(dots)) == WINDOW


def test_a_plane_of_what_is_not_there_is_refused(run: Run) -> None:
    with pytest.raises(ValueError, match=r"step must lie in \[0, 1300\), got 1300"):
        draw_partition(run, [1300], *PLANE)
    with pytest.raises(ValueError, match="got smell"):
        draw_partition(run, [5], "smell", "sound")
    with pytest.raises(ValueError, match=r"beam must lie in \[0, 4\], got 5"):
        draw_partition(run, [5], *PLANE, at={"beam": 5.0})
