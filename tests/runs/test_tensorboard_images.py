"""The pictures in TensorBoard: what is kept for them, and what they show."""

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary

from torch_iac.runs import tensorboard_images
from torch_iac.runs.charts import BAD, GOOD, SIZE
from torch_iac.runs.followed_regions import Family
from torch_iac.runs.tensorboard_images import ERRORS, PROGRESS, RegionHistory, Scene, ZoneHistory

PARENTS = [-1, 0, 0, 2, 2]
FAMILY = Family(PARENTS, np.array([1, 3, 4]), np.array([0, -1, 1, -1, -1]), np.full(5, 0.5))


def pixels(shown: Summary.Image) -> NDArray[np.uint8]:
    return np.asarray(Image.open(BytesIO(shown.encoded_image_string)).convert("RGB"))


def n_like(picture: NDArray[np.uint8], colour: str) -> int:
    red_green_blue = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return int((picture == red_green_blue).all(axis=-1).sum())


def history() -> RegionHistory:
    kept = RegionHistory()
    kept.add(100, np.array([0]), np.array([0.1]), np.array([0.9]))
    kept.add(200, np.array([1, 2]), np.array([0.2, 0.3]), np.array([0.8, 0.7]))
    kept.add(300, np.array([1, 3, 4]), np.array([0.4, 0.5, 0.6]), np.array([0.6, 0.5, 0.4]))
    return kept


def scene(n_decisions: int = 300) -> Scene:
    zones = np.array([-1, 0, 1, 1, 2])
    return Scene(n_decisions, FAMILY, zones, ("f1", "f2", "f3"), [3, 4])


def test_the_picture_of_the_calibration_is_of_the_last_decisions_of_the_first_agents(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tensorboard_images, "N_CALIBRATED", 5)
    monkeypatch.setattr(tensorboard_images, "N_AGENTS_CALIBRATED", 2)
    chart = tensorboard_images.CalibrationChart()
    chart.add({"expected_errors": np.full((3, 4), np.nan), "errors": np.ones((3, 4))})
    assert not chart.is_known
    numbers = np.arange(28.0).reshape(7, 4)
    for rows in (slice(3), slice(3, 3), slice(3, 4), slice(4, 7)):
        columns = {"expected_errors": numbers[rows].copy(), "errors": numbers[rows] + 1}
        chart.add(columns)
        columns["expected_errors"][:] = 0.0  # buffers are reused
    assert chart.is_known
    assert chart._expected.tolist() == numbers[2:, :2].tolist()
    assert chart._actual.tolist() == (numbers[2:, :2] + 1).tolist()


@pytest.mark.parametrize(
    ("n_deciles", "color"), [(10, (0, 114, 178)), (1, (0, 114, 178))], ids=["ten", "one"]
)
def test_a_calibrated_mp_keeps_to_the_diagonal(n_deciles: int, color: tuple[int, int, int]) -> None:
    deciles = np.full((2, 10), np.nan)
    deciles[:, :n_deciles] = np.geomspace(0.002, 0.2, n_deciles)
    shown = tensorboard_images._decile_picture(deciles)
    picture = Image.open(BytesIO(shown.encoded_image_string))
    assert picture.size == (shown.width, shown.height)
    pixels = np.asarray(picture)
    rows, columns = np.nonzero((pixels == color).all(axis=-1))
    assert len(rows)
    assert np.abs(shown.height - rows - columns).max() <= 9  # the radius of a point, twice, and 1


def test_errors_of_zero_have_a_place_on_logarithmic_axes() -> None:
    assert tensorboard_images._decile_picture(np.zeros((2, 10))).encoded_image_string


def test_before_a_region_was_born_its_line_is_its_ancestors() -> None:
    kept = history()
    lines = kept._lines_of_descent(PARENTS, PROGRESS)[[1, 3, 4]]
    assert lines == pytest.approx(np.array([[0.1, 0.2, 0.4], [0.1, 0.3, 0.5], [0.1, 0.3, 0.6]]))
    lines = kept._lines_of_descent(PARENTS, ERRORS)[[1, 3, 4]]
    assert lines == pytest.approx(np.array([[0.9, 0.8, 0.6], [0.9, 0.7, 0.5], [0.9, 0.7, 0.4]]))
    assert kept._births(5).tolist() == [0, 1, 1, 2, 2]


def test_the_history_covers_the_whole_run_in_bounded_memory() -> None:
    kept = RegionHistory()
    for moment in range(10_000):
        kept.add(moment, np.array([0]), np.array([float(moment)]), np.array([0.0]))
    line = kept._lines_of_descent([-1], PROGRESS)[0]
    assert len(line) <= tensorboard_images.N_MOMENTS
    assert line.tolist() == kept._decisions
    assert line[0] == 0.0
    assert len(set(np.diff(line))) == 1
    assert line[-1] > 9_800


@given(st.lists(st.tuples(st.integers(1, 400), st.integers(0, 9)), min_size=1, max_size=700))
def test_zones_are_counted_once_however_many_are_joined(logs: list[tuple[int, int]]) -> None:
    kept, end = ZoneHistory(), 0
    for n_decisions, share in logs:
        end += n_decisions
        first = n_decisions * share // 10
        kept.add(end, np.array([first, n_decisions - first]))
    assert len(kept._counts) <= tensorboard_images.N_MOMENTS
    assert kept._ends[-1] == end
    assert np.sum(kept._counts) == end
    middles, shares = kept.shares()
    assert shares.sum(axis=1) == pytest.approx(np.ones(len(middles)))
    # Windows are equally long, so that their mean is the share of all time.
    assert shares.mean(axis=0) == pytest.approx(np.sum(kept._counts, axis=0) / end)


def test_a_state_gives_the_same_pictures() -> None:
    before, after = history(), RegionHistory()
    after.load_state(before.state())
    assert after.draw_map(scene()) == before.draw_map(scene())
    assert after.draw_lines(scene(), ERRORS) == before.draw_lines(scene(), ERRORS)
    zones, again = ZoneHistory(), ZoneHistory()
    for n_logs in range(600):
        zones.add(100 * n_logs + 100, np.array([n_logs % 100, 100 - n_logs % 100]))
    again.load_state(zones.state())
    zones.add(70_000, np.array([5000, 5000]))
    again.add(70_000, np.array([5000, 5000]))
    assert again.draw(("f1", "f2")) == zones.draw(("f1", "f2"))


def test_the_map_is_blue_where_errors_fall_and_vermillion_where_they_grow() -> None:
    falls, grows = RegionHistory(), RegionHistory()
    for kept, sign in ((falls, 1), (grows, -1)):
        kept.add(100, np.array([1, 3, 4]), np.full(3, sign * 0.2), np.ones(3))
    good, bad = (pixels(kept.draw_map(scene(100))) for kept in (falls, grows))
    n_cells = SIZE[0] * SIZE[1] // 4
    assert n_like(good, GOOD) > n_cells > n_like(good, BAD)
    assert n_like(bad, BAD) > n_cells > n_like(bad, GOOD)
    assert good.shape == (*SIZE[::-1], 3)


@pytest.mark.parametrize("errors", [0.0, np.nan, -0.5], ids=["zero", "unknown", "negative"])
def test_any_progress_and_any_errors_can_be_drawn(errors: float) -> None:
    kept = RegionHistory()
    kept.add(1, np.array([0]), np.array([min(0.0, errors)]), np.array([errors]))
    alone = Family([-1], np.array([0]), np.array([-1]), np.array([np.nan]))
    one = Scene(1, alone, np.array([-1]), (), [0])
    for shown in (
        kept.draw_map(one),
        kept.draw_lines(one, ERRORS),
        kept.draw_lines(one, PROGRESS),
    ):
        assert pixels(shown).std() > 0


def test_a_picture_of_many_regions_draws_a_bounded_number_of_curves() -> None:
    n_leaves = 5000
    parents = [-1] + [region // 2 for region in range(2 * n_leaves - 2)]
    regions = tensorboard_images._some(list(range(n_leaves)), tensorboard_images.N_LINES)
    assert len(regions) <= tensorboard_images.N_LINES
    drawn = tensorboard_images._with_ancestors(regions, parents)
    assert set(regions) <= set(drawn)
    assert all(parents[region] in drawn for region in drawn if region)
