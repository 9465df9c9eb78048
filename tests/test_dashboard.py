"""What TensorBoard shows of a run."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.synthetic_run import ZONES, write_run
from torch_iac import dashboard
from torch_iac.runs import load_run


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
    shares = [board.Scalars(f"zones/{name}")[-1].value for name in ZONES]
    assert shares == pytest.approx(np.bincount(last["zone"].to_numpy()) / 200)
    top = [board.Scalars(f"top_progress/{rank}")[-1].value for rank in range(1, 4)]
    assert top == sorted(top, reverse=True)
    assert {"progress/mean", "progress/best", "regions/number"} <= set(tags["scalars"])
    assert "error/expected" not in tags["scalars"]  # nobody expected anything
    assert tags["histograms"] == ["progress/regions"]
    assert tags["images"] == ["progress/map"]
    assert "custom_scalars__config__" in tags["tensors"]


def test_a_region_of_agent_0_has_its_own_curve_while_it_is_a_leaf(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=600)
    root = [event.step for event in events(folder).Scalars("region_error/0000")]
    split = pq.read_table(folder / "regions.parquet")["split_step"][0].as_py()
    assert root == [step for step in range(100, 601, 100) if step <= split]


def test_the_number_of_tags_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dashboard, "N_REGIONS_SHOWN", 2)
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
    chart = dashboard._ProgressMap()
    chart.add(np.array([0]), np.array([0.1]))
    chart.add(np.array([1, 2]), np.array([0.2, 0.3]))
    chart.add(np.array([1, 3, 4]), np.array([0.4, 0.5, 0.6]))
    lines = chart._lines_of_descent([-1, 0, 0, 2, 2])
    assert lines[[1, 3, 4]].tolist() == [[0.1, 0.2, 0.4], [0.1, 0.3, 0.5], [0.1, 0.3, 0.6]]


def test_the_map_covers_the_whole_run_in_bounded_memory() -> None:
    chart = dashboard._ProgressMap()
    for moment in range(10_000):
        chart.add(np.array([0]), np.array([float(moment)]))
    kept = chart._lines_of_descent([-1])[0]
    assert len(kept) <= dashboard.MAP_COLUMNS
    assert kept[0] == 0.0
    assert len(set(np.diff(kept))) == 1
    assert kept[-1] > 9_800
