"""What TensorBoard shows of a run."""

import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.synthetic_run import ZONES, write_run
from torch_iac.runs import tensorboard
from torch_iac.runs.reader import load_run

ERROR = "prediction_error"
PICTURES = [
    "development/view_figure_2",
    "development/view_figure_3",
    "development/view_map",
    "development/view_progress",
]


def events(folder: Path) -> EventAccumulator:
    accumulator = EventAccumulator(str(folder), size_guidance={"images": 0})
    accumulator.Reload()
    return accumulator


def test_tensorboard_shows_the_run_so_far(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_agents=2, n_decisions=1000)
    board = events(folder)
    tags = board.Tags()
    table = load_run(folder).steps
    last = table.slice(2 * 900)
    assert [event.step for event in board.Scalars("prediction_error/mean")] == list(
        range(100, 1001, 100)
    )
    assert board.Scalars("prediction_error/mean")[-1].value == pytest.approx(
        last["error"].to_numpy().mean()
    )
    shares = [board.Scalars(f"development/time_in_{name}")[-1].value for name in ZONES]
    assert shares == pytest.approx(np.bincount(last["zone"].to_numpy()) / 200)
    aggregates = {"learning_progress/mean", "learning_progress/best", "development/n_regions"}
    assert aggregates <= set(tags["scalars"])
    zones, progress = last["zone"].to_numpy(), last["progress"].to_numpy()
    for zone, name in enumerate(ZONES):
        logged = board.Scalars(f"learning_progress/in_{name}")[-1].value
        assert logged == pytest.approx(progress[zones == zone].mean())
    assert "prediction_error/expected" not in tags["scalars"]  # nobody expected anything
    assert tags["histograms"] == ["learning_progress/spread"]
    assert sorted(tags["images"]) == PICTURES
    assert "custom_scalars__config__" in tags["tensors"]


def test_tensorboard_shows_shadows_and_whether_mp_is_right(tmp_path: Path) -> None:
    folder = write_run(
        tmp_path, 2, n_decisions=1000, shadows={"knn": 2.0, "mlp": 0.5}, meta=True, rows_per_part=70
    )
    board, last = events(folder), load_run(folder).steps.slice(2 * 900)
    error = board.Scalars("prediction_error/mean")[-1].value
    assert board.Scalars("prediction_error/knn")[-1].value == pytest.approx(2 * error)
    assert board.Scalars("prediction_error/mlp")[-1].value == pytest.approx(error / 2)
    zones = last["zone"].to_numpy()
    for kind, column in (("expected", "expected_error"), ("actual", "error")):
        means = [last[column].to_numpy()[zones == zone].mean() for zone in range(3)]
        logged = [board.Scalars(f"mp_calibration/{zone}/{kind}")[-1].value for zone in ZONES]
        assert logged == pytest.approx(means)
    assert sorted(board.Tags()["images"]) == [*PICTURES, "mp_calibration/deciles"]


def test_a_region_has_a_curve_that_says_where_it_lies_until_it_is_cut(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=1500)
    board, family = events(folder), pq.read_table(folder / "regions.parquet").to_pylist()
    named = [tag for tag in board.Tags()["scalars"] if tag.startswith("learning_progress/region")]
    assert {
        "learning_progress/region 0",
        "learning_progress/region 3 f3: left_wheel <= 0, of 2",
    } <= (set(named))
    for tag in named:
        row = family[int(re.findall(r"region (\d+)", tag)[0])]
        steps = [event.step for event in board.Scalars(tag)]
        end = row["split_step"] if row["split_step"] >= 0 else 1500
        assert row["born_step"] < steps[0] <= steps[-1] <= end
        assert [event.step for event in board.Scalars(tag.replace("learning_progress", ERROR))] == (
            steps
        )
        if row["parent"] >= 0:
            parent = family[row["parent"]]
            assert f"{parent['cut_dimension']} " in tag
            assert tag.endswith(f"{parent['cut_value']:.3g}, of {row['parent']}")


def test_pictures_come_early_and_then_at_every_tenth_log(tmp_path: Path) -> None:
    board = events(write_run(tmp_path, n_decisions=2100))
    for tag in PICTURES:
        assert [event.step for event in board.Images(tag)] == [100, 200, 500, 1000, 2000]


def test_a_world_without_zones_has_no_figure_3(tmp_path: Path) -> None:
    board = events(write_run(tmp_path, n_decisions=600, zone_names=None))
    assert "development/view_figure_3" not in board.Tags()["images"]
    assert "development/view_figure_2" in board.Tags()["images"]
    assert "learning_progress/region 2: sound > 0.667, of 0" in board.Tags()["scalars"]


def test_every_chart_of_custom_scalars_has_one_tag_that_is_logged(tmp_path: Path) -> None:
    board = events(write_run(tmp_path, shadows={"knn+1": 2.0}, meta=True, n_decisions=300))
    logged = board.Tags()["scalars"]
    layout = tensorboard._layout(ZONES, ["knn+1"])
    charts = [chart for of in layout.values() for chart in of.values()]
    matches = [[tag for tag in logged if re.match(of, tag)] for _, (of,) in charts]
    assert [len(tags) for tags in matches] == [1] * len(charts)
    assert len({tags[0] for tags in matches}) == len(charts)


def test_logs_that_straddle_parts_lose_and_repeat_nothing(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=21, rows_per_part=4, log_every=7)
    errors = load_run(folder).steps["error"].to_numpy()
    logged = [event.value for event in events(folder).Scalars("prediction_error/mean")]
    assert logged == pytest.approx(errors.reshape(3, 7).mean(axis=1))
