"""Sheets: what they say of a decision."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.pictures import alike_in_grey, looks_of, overlapping
from tests.synthetic_run import write_run
from torch_iac.analysis.region_history import region_bounds
from torch_iac.analysis.style import ZONE_COLOURS
from torch_iac.replay import frames
from torch_iac.replay.frames import HEIGHT, ROOM, ROOM_AT, WIDTH, Frame, Sheets
from torch_iac.replay.scenes import Stage
from torch_iac.runs.reader import Run, load_run

WORLD = {"sensor_units": ("m", "cm")}
STAGE = Stage("The focus on f2", 1200, 100)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A made-up run, long enough for regions with several cuts."""
    return load_run(write_run(tmp_path_factory.mktemp("run"), n_decisions=1300))


def sheet_of(run: Run, decision: int, monkeypatch: pytest.MonkeyPatch) -> Figure:
    """Return the sheet of a decision before it is drawn."""
    figures: list[Figure] = []

    def keep(figure: Figure) -> Frame:
        figures.append(figure)
        return np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    monkeypatch.setattr(frames, "_drawn", keep)
    Sheets(run, 0, WORLD).sheet(run.table(agent=0).to_pylist()[decision], STAGE)
    return figures[-1]


def words(figure: Figure) -> str:
    """Return all that a sheet says."""
    texts = [*figure.texts, *(text for axes in figure.axes for text in axes.texts)]
    return " | ".join(" ".join(text.get_text().split()) for text in texts)


def test_a_sheet_leaves_room_for_the_world(run: Run) -> None:
    left, top = ROOM_AT
    width, height = ROOM
    sheet = Sheets(run, 0, WORLD).sheet(run.table(agent=0).to_pylist()[1250], STAGE)
    assert sheet.shape == (HEIGHT, WIDTH, 3)
    assert (sheet[top : top + height, left : left + width] == 255).all()
    assert (sheet[:, -8:] == 255).all()  # nothing is cut off


def test_a_title_says_which_decisions_follow(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    blank = np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    def keep(figure: Figure) -> Frame:
        said.append(words(figure))
        return blank

    monkeypatch.setattr(frames, "_drawn", keep)
    assert Sheets(run, 0, WORLD).card(STAGE) is blank
    assert "The focus on f2 | decisions 1,200 to 1,299 of 1,300" in said[0]


def test_a_sheet_says_what_the_record_says(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    row = run.table(agent=0).to_pylist()[1299]
    said = words(sheet_of(run, 1299, monkeypatch))
    depth = run.family()["depth"].to_pylist()[row["region"]]
    for text in (
        "decision 1,299 of 1,300",
        run.zone_names[row["zone"]],
        "random action" if row["random_action"] else "action chosen by the drive",
        f"Region {row['region']}, {depth} cuts from the root",
        f"learning progress {row['progress']:+.4f}",
        f"predicted {row['prediction/toy_distance']:.2f} cm",
        f"outcome {row['outcome/toy_distance']:.2f} cm",
        f"error {row['error']:.4f}",
        f"{row['action/sound']:.2f}",
        "whatever is sensed",
    ):
        assert text in said


def test_a_sheet_says_where_sensors_were_cut(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    cut = {"beam": (0.0, 1.25), "toy_distance": (2.0, 5.0)}
    monkeypatch.setattr(frames, "region_bounds", lambda *_: cut)
    assert "where beam up to 1.25 m, toy_distance above 2.00 cm" in words(
        sheet_of(run, 5, monkeypatch)
    )


def test_the_part_of_an_axis_that_the_region_covers_is_marked(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = run.table(agent=0).to_pylist()[1299]
    _wheel, sound, *_ = sheet_of(run, 1299, monkeypatch).axes
    bar, marker = sound.lines
    assert tuple(np.asarray(bar.get_xdata())) == region_bounds(run, row["region"])["sound"]
    assert np.asarray(marker.get_xdata()).tolist() == [row["action/sound"]]
    assert marker.get_color() == ZONE_COLOURS[row["zone"]]


def test_the_time_to_come_is_pale(run: Run) -> None:
    """The line of f2, which is dark until the cursor and pale after it."""
    sheet = Sheets(run, 0, WORLD).sheet(run.table(agent=0).to_pylist()[650], STAGE)
    strip = sheet[612:665, 95:1180].astype(int)  # between the axes
    dark = strip.min(axis=2).min(axis=0) < 60  # its colours have a channel that is all but 0
    cursor = round(650 / 1300 * 1110) - 5
    assert dark[115 : cursor - 5].all()  # from the middle of the first window on
    assert not dark[cursor + 5 :].any()


def test_a_world_without_zones_has_sheets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = load_run(write_run(tmp_path, n_decisions=3, zone_names=None))
    said = words(sheet_of(run, 2, monkeypatch))
    assert "Region 0, the root" in said
    assert "Share of time" not in said


def test_the_lines_of_zones_can_be_told_apart_and_have_their_names(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = sheet_of(run, 1250, monkeypatch)
    time = figure.axes[-1]
    assert [text.get_text() for text in time.texts] == list(run.zone_names)
    assert overlapping(figure) == []
    for axes in figure.axes[:-1]:
        axes.remove()
    zones = [look for look in looks_of(figure) if look[0] in ZONE_COLOURS]
    assert len(zones) == len(run.zone_names)
    assert alike_in_grey(zones) == []
