"""What TensorBoard shows of a run."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.synthetic_run import ZONES, write_run
from torch_iac.runs import tensorboard, tensorboard_images
from torch_iac.runs.reader import load_run


def events(folder: Path) -> EventAccumulator:
    accumulator = EventAccumulator(str(folder))
    accumulator.Reload()
    return accumulator


def test_tensorboard_shows_the_run_so_far(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_agents=2, n_decisions=1000)
    board = events(folder)
    tags = board.Tags()
    table = load_run(folder).steps
    last = table.slice(2 * 900)
    assert [event.step for event in board.Scalars("error/mean")] == list(range(100, 1001, 100))
    assert board.Scalars("error/mean")[-1].value == pytest.approx(last["error"].to_numpy().mean())
    shares = [board.Scalars(f"development/time_in_{name}")[-1].value for name in ZONES]
    assert shares == pytest.approx(np.bincount(last["zone"].to_numpy()) / 200)
    top = [board.Scalars(f"top_progress/{rank}")[-1].value for rank in range(1, 4)]
    assert top == sorted(top, reverse=True)
    assert {"progress/mean", "progress/best", "development/n_regions"} <= set(tags["scalars"])
    assert "error/expected" not in tags["scalars"]  # nobody expected anything
    assert tags["histograms"] == ["progress/regions"]
    assert tags["images"] == ["development/map"]
    assert "custom_scalars__config__" in tags["tensors"]


def test_tensorboard_shows_shadows_and_whether_mp_is_right(tmp_path: Path) -> None:
    folder = write_run(
        tmp_path, 2, n_decisions=1000, shadows={"knn": 2.0, "mlp": 0.5}, meta=True, rows_per_part=70
    )
    board, last = events(folder), load_run(folder).steps.slice(2 * 900)
    error = board.Scalars("error/mean")[-1].value
    assert board.Scalars("error/knn")[-1].value == pytest.approx(2 * error)
    assert board.Scalars("error/mlp")[-1].value == pytest.approx(error / 2)
    zones = last["zone"].to_numpy()
    for kind, column in (("expected", "expected_error"), ("actual", "error")):
        means = [last[column].to_numpy()[zones == zone].mean() for zone in range(3)]
        logged = [board.Scalars(f"mp_calibration/{zone}/{kind}")[-1].value for zone in ZONES]
        assert logged == pytest.approx(means)
    assert board.Tags()["images"] == ["development/map", "mp_calibration/deciles"]


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


def test_a_region_of_agent_0_has_its_own_curve_while_it_is_a_leaf(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=600)
    root = [event.step for event in events(folder).Scalars("region_error/0000")]
    split = pq.read_table(folder / "regions.parquet")["split_step"][0].as_py()
    assert root == [step for step in range(100, 601, 100) if step <= split]


def test_the_number_of_tags_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tensorboard, "N_REGIONS_SHOWN", 2)
    tags = events(write_run(tmp_path, n_decisions=700)).Tags()["scalars"]
    assert {tag for tag in tags if tag.startswith("region_progress")} == {
        "region_progress/0000",
        "region_progress/0001",
    }


def test_logs_that_straddle_parts_lose_and_repeat_nothing(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=21, rows_per_part=4, log_every=7)
    errors = load_run(folder).steps["error"].to_numpy()
    logged = [event.value for event in events(folder).Scalars("error/mean")]
    assert logged == pytest.approx(errors.reshape(3, 7).mean(axis=1))


def test_a_row_of_the_map_is_a_leaf_with_its_ancestors_before_it() -> None:
    chart = tensorboard_images.ProgressMap()
    chart.add(np.array([0]), np.array([0.1]))
    chart.add(np.array([1, 2]), np.array([0.2, 0.3]))
    chart.add(np.array([1, 3, 4]), np.array([0.4, 0.5, 0.6]))
    lines = chart._lines_of_descent([-1, 0, 0, 2, 2])
    assert lines[[1, 3, 4]].tolist() == [[0.1, 0.2, 0.4], [0.1, 0.3, 0.5], [0.1, 0.3, 0.6]]


def test_the_map_covers_the_whole_run_in_bounded_memory() -> None:
    chart = tensorboard_images.ProgressMap()
    for moment in range(10_000):
        chart.add(np.array([0]), np.array([float(moment)]))
    kept = chart._lines_of_descent([-1])[0]
    assert len(kept) <= tensorboard_images.MAP_COLUMNS
    assert kept[0] == 0.0
    assert len(set(np.diff(kept))) == 1
    assert kept[-1] > 9_800
