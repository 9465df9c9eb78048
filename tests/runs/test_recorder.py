"""What a run leaves behind."""

import copy
import json
import pickle
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.synthetic_run import SPACE, ZONES, SyntheticPopulation, write_run
from torch_iac.config import IACConfig
from torch_iac.internal.processor import processor
from torch_iac.records import Step
from torch_iac.runs import reader, statistics
from torch_iac.runs import recorder as run_recorder
from torch_iac.runs.reader import load_run
from torch_iac.runs.recorder import Recorder, log_interval, write_config
from torch_iac.runs.schema import region_table

COLUMNS = [
    "step",
    "agent",
    "seed",
    "zone",
    "random_action",
    "action/left_wheel",
    "action/sound",
    "sensor/beam",
    "sensor/toy_distance",
    "outcome/toy_distance",
    "prediction/toy_distance",
    "error",
    "expected_error",
    "region",
    "progress",
]


def parts(folder: Path) -> list[Path]:
    return sorted((folder / "steps").iterdir())


def test_every_decision_of_every_agent_comes_back_as_it_was(tmp_path: Path) -> None:
    population = SyntheticPopulation(n_agents=3, n_decisions=20)
    decisions = [population.decide() for _ in range(20)]
    with Recorder(tmp_path, population, ZONES, rows_per_part=3 * 8) as recorder:
        for step, zones in decisions:
            recorder.record(step, zones)

    table = pq.read_table(parts(tmp_path))
    assert table.column_names == COLUMNS
    assert table["step"].to_pylist() == [number for number in range(20) for _ in range(3)]
    assert table["agent"].to_pylist() == [0, 1, 2] * 20
    assert table["seed"].to_pylist() == [100, 101, 102] * 20
    kept: dict[str, list[Any]] = {
        "zone": [zones for _, zones in decisions],
        "random_action": [step.random_actions for step, _ in decisions],
        "action/sound": [step.actions[:, 1] for step, _ in decisions],
        "sensor/beam": [step.sensors[:, 0] for step, _ in decisions],
        "outcome/toy_distance": [step.outcomes[:, 0] for step, _ in decisions],
        "prediction/toy_distance": [step.predictions[:, 0] for step, _ in decisions],
        "error": [step.errors for step, _ in decisions],
        "region": [step.regions for step, _ in decisions],
        "progress": [step.progress for step, _ in decisions],
    }
    for name, values in kept.items():
        assert table[name].to_numpy().tolist() == np.concatenate(values).tolist(), name


def test_recording_copies_since_worlds_and_agents_reuse_their_buffers(tmp_path: Path) -> None:
    population = SyntheticPopulation(1, 2)
    step, zones = population.decide()
    sensors = step.sensors.clone()
    with Recorder(tmp_path, population, ZONES) as recorder:
        recorder.record(step, zones)
        step.sensors.zero_()
    assert pq.read_table(parts(tmp_path))["sensor/beam"].to_pylist() == [sensors[0, 0].item()]


def test_an_expected_error_is_null_without_mp_and_kept_with_it(tmp_path: Path) -> None:
    population = SyntheticPopulation(2, 2)
    step, zones = population.decide()
    with Recorder(tmp_path, population, ZONES) as recorder:
        recorder.record(step, zones)
        expected = torch.tensor([0.25, 0.5])
        recorder.record(replace(step, number=1, expected_errors=expected), zones)
    table = pq.read_table(parts(tmp_path))
    assert table["expected_error"].to_pylist() == [None, None, 0.25, 0.5]


def test_each_shadow_has_its_columns(tmp_path: Path) -> None:
    population = SyntheticPopulation(2, 3, shadows={"knn": 2.0, "mlp": 0.5})
    steps = []
    with Recorder(tmp_path, population, ZONES) as recorder:
        for _ in range(3):
            step, zones = population.decide()
            recorder.record(step, zones)
            steps.append(step)
    table = pq.read_table(parts(tmp_path))
    assert table.column_names == [
        *COLUMNS,
        "shadow/knn/prediction/toy_distance",
        "shadow/knn/error",
        "shadow/mlp/prediction/toy_distance",
        "shadow/mlp/error",
    ]
    for place, name in enumerate(("knn", "mlp")):
        shadows = [step.shadows[place] for step in steps]
        assert {shadow.name for shadow in shadows} == {name}
        errors = torch.cat([shadow.errors for shadow in shadows])
        predictions = torch.cat([shadow.predictions[:, 0] for shadow in shadows])
        assert table[f"shadow/{name}/error"].to_pylist() == errors.tolist()
        assert table[f"shadow/{name}/prediction/toy_distance"].to_pylist() == predictions.tolist()
    assert table.schema.field("shadow/knn/error").type == pa.float64()
    assert table.schema.field("shadow/knn/prediction/toy_distance").type == pa.float32()


def test_of_a_large_population_the_first_agents_are_recorded_and_windows_of_all(
    tmp_path: Path,
) -> None:
    whole = load_run(write_run(tmp_path / "whole", 4, 600, shadows={"knn": 2.0}, meta=True))
    few = load_run(
        write_run(tmp_path / "few", 4, 600, shadows={"knn": 2.0}, meta=True, n_recorded=2)
    )
    assert (few.n_recorded, few.n_agents, few.n_decisions) == (2, 4, 600)
    assert few.config["n_recorded"] == 2
    assert few.steps == whole.steps.filter(pc.field("agent") < 2)
    assert few.regions == whole.regions
    windows = [pq.read_table(sorted((run.folder / "windows").iterdir())) for run in (whole, few)]
    for table in windows:
        assert table.column_names[:6] == [
            *("step", "agent", "seed"),
            *(f"decisions/{zone}" for zone in ZONES),
        ]
        assert {"error_sum/f1", "expected_error_sum/f3", "shadow/knn/error_sum/f2"} <= set(
            table.column_names
        )
    for name, sums in whole.window_sums.sums.items():
        np.testing.assert_allclose(few.window_sums.sums[name], sums, rtol=1e-12, err_msg=name)


def test_windows_sum_up_the_steps(tmp_path: Path) -> None:
    """Whatever parts and logs they were written in."""
    folder = write_run(tmp_path, 3, 700, rows_per_part=3 * 70, log_every=90, shadows={"knn": 2.0})
    run = load_run(folder)
    zones = run.column("zone")
    assert run.window_sums.counts.sum(axis=2).tolist() == [[250] * 3, [250] * 3, [200] * 3]
    for column in ("error", "progress", "shadow/knn/error"):
        values = run.column(column)
        for window, first in enumerate((0, 250, 500)):
            here = slice(first, first + 250)
            for zone in range(3):
                expected = np.sum(values[here], axis=0, where=zones[here] == zone)
                np.testing.assert_allclose(run.window_sums.sums[column][window, :, zone], expected)
    assert np.isnan(run.window_sums.sums["expected_error"]).all()
    table = pq.read_table(sorted((folder / "windows").iterdir()))
    counted = table.filter(pc.field("decisions/f1") > 0)
    assert counted["expected_error_sum/f1"].null_count == counted.num_rows


def test_windows_begin_with_the_first_decision_that_is_recorded(tmp_path: Path) -> None:
    population = SyntheticPopulation(2, 400)
    for _ in range(90):
        population.decide()
    with Recorder(tmp_path, population, ZONES) as recorder:
        for _ in range(300):
            recorder.record(*population.decide())
    run = load_run(tmp_path)
    assert run.window_sums.counts.sum(axis=2).tolist() == [[250, 250], [50, 50]]
    windows = pq.read_table(sorted((tmp_path / "windows").iterdir()))
    assert windows["step"].to_pylist() == [90, 90, 340, 340]


@pytest.mark.parametrize("n_recorded", [0, 4])
def test_there_must_be_so_many_agents_to_record(tmp_path: Path, n_recorded: int) -> None:
    with pytest.raises(ValueError, match=rf"n_recorded must lie in \[1, 3\], got {n_recorded}"):
        Recorder(tmp_path / "a", SyntheticPopulation(3, 1), n_recorded=n_recorded)
    assert not (tmp_path / "a").exists()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_steps_may_be_on_a_gpu(tmp_path: Path) -> None:
    population = SyntheticPopulation(3, 20)
    decisions = [population.decide() for _ in range(20)]
    with (
        Recorder(tmp_path / "cpu", population, ZONES, n_recorded=2) as here,
        Recorder(tmp_path / "gpu", population, ZONES, n_recorded=2) as there,
    ):
        for step, zones in decisions:
            here.record(step, zones)
            moved: dict[str, Any] = {
                name: value.cuda() if isinstance(value, torch.Tensor) else value
                for name, value in vars(step).items()
            }
            there.record(Step(**moved), torch.tensor(zones).cuda())
    assert load_run(tmp_path / "cpu").steps == load_run(tmp_path / "gpu").steps


@pytest.mark.parametrize("name", ["main", "mean", "expected"])
def test_a_shadow_cannot_have_the_name_of_another_error(tmp_path: Path, name: str) -> None:
    population = SyntheticPopulation(1, 1, shadows={name: 1.0})
    with pytest.raises(ValueError, match=f"must not be called main, mean, expected, got {name}"):
        Recorder(tmp_path / "a", population)
    assert not (tmp_path / "a").exists()


def test_a_world_without_zones_has_no_zone_column(tmp_path: Path) -> None:
    write_run(tmp_path, n_decisions=5, zone_names=None)
    assert pq.read_table(parts(tmp_path)).column_names == [c for c in COLUMNS if c != "zone"]


@pytest.mark.parametrize("zone_names", [ZONES, None])
def test_zones_must_be_given_if_and_only_if_they_have_names(
    tmp_path: Path, zone_names: tuple[str, ...] | None
) -> None:
    population = SyntheticPopulation(1, 1)
    step, zones = population.decide()
    recorder = Recorder(tmp_path, population, zone_names)
    with pytest.raises(ValueError, match="if, and only if"):
        recorder.record(step, zones if zone_names is None else None)
    recorder.close()


def test_rows_are_on_disk_when_flush_returns_and_parts_have_the_agreed_size(tmp_path: Path) -> None:
    population = SyntheticPopulation(2, 10)
    recorder = Recorder(tmp_path, population, ZONES, rows_per_part=8)
    for _ in range(9):
        recorder.record(*population.decide())
    assert [pq.read_metadata(path).num_rows for path in parts(tmp_path)] == [8, 8]
    recorder.flush()
    assert [pq.read_metadata(path).num_rows for path in parts(tmp_path)] == [8, 8, 2]
    recorder.flush()
    assert [path.name for path in parts(tmp_path)] == [f"part-0000{i}.parquet" for i in range(3)]
    recorder.close()


@pytest.mark.parametrize(("place", "broken"), [(0, "regions.parquet"), (2, "part-00000.parquet")])
def test_a_file_that_could_not_be_finished_has_no_name_and_loses_no_decision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: int, broken: str
) -> None:
    """Of the files of a part, one after the other, one is broken half way."""
    written: list[pa.Table] = []

    def break_half_way(table: pa.Table, file: Any, **options: Any) -> None:
        written.append(table)
        if len(written) == place + 1:
            file.write(b"half a file")
            raise OSError("disk full")
        write_table(table, file, **options)

    write_table = pq.write_table
    population = SyntheticPopulation(1, 1)
    recorder = Recorder(tmp_path, population, ZONES)
    recorder.record(*population.decide())
    with monkeypatch.context() as patched:
        patched.setattr(pq, "write_table", break_half_way)
        with pytest.raises(OSError, match="disk full"):
            recorder.flush()
    assert not list((tmp_path / "steps").rglob("part*"))
    assert broken != "regions.parquet" or not (tmp_path / broken).exists()
    recorder.close()
    assert [path.name for path in parts(tmp_path)] == ["part-00000.parquet"]
    assert pq.read_table(parts(tmp_path)).num_rows == 1


def test_an_interrupted_run_keeps_its_decisions_and_is_not_called_finished(tmp_path: Path) -> None:
    population = SyntheticPopulation(1, 10)

    def live_and_interrupt() -> None:
        with Recorder(tmp_path, population, ZONES) as recorder:
            for _ in range(7):
                recorder.record(*population.decide())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        live_and_interrupt()
    assert pq.read_table(parts(tmp_path)).num_rows == 7
    assert not (tmp_path / "summary.json").exists()


@pytest.mark.parametrize("name", ["config.json", "steps", "summary.json", "events.out.tfevents.1"])
def test_a_folder_that_holds_a_run_is_refused_and_not_touched(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / name).write_text("a run")
    with pytest.raises(
        FileExistsError, match=r"a already holds a run; resume it or choose another folder"
    ):
        Recorder(folder, SyntheticPopulation(1, 1))
    assert [path.name for path in folder.iterdir()] == [name]
    assert (folder / name).read_text() == "a run"


@pytest.mark.parametrize("folder", ["a", "a/b/c"])
def test_a_run_folder_cannot_be_a_file_nor_lie_in_one(tmp_path: Path, folder: str) -> None:
    (tmp_path / "a").write_text("a file")
    with pytest.raises(
        NotADirectoryError, match=rf"{folder} cannot be a run folder: .*a is a file"
    ):
        Recorder(tmp_path / folder, SyntheticPopulation(1, 1))
    assert (tmp_path / "a").read_text() == "a file"


@pytest.mark.parametrize("option", ["log_every", "rows_per_part"])
def test_counts_are_checked_before_anything_is_written(tmp_path: Path, option: str) -> None:
    with pytest.raises(ValueError, match=f"{option} must be at least 1, got 0"):
        Recorder(tmp_path / "a", SyntheticPopulation(1, 1), **{option: 0})  # type: ignore[arg-type]
    assert not (tmp_path / "a").exists()


def test_the_config_says_what_is_needed_to_read_the_run(tmp_path: Path) -> None:
    with Recorder(tmp_path, SyntheticPopulation(2, 1), ZONES, {"command": "train"}):
        config = json.loads((tmp_path / "config.json").read_text())
    assert config == {
        "command": "train",
        "space": {
            "actions": {"left_wheel": [-1.0, 1.0], "sound": [0.0, 1.0]},
            "sensors": {"beam": [0.0, 4.0], "toy_distance": [0.0, 5.0]},
            "outcomes": {"toy_distance": [0.0, 5.0]},
        },
        "seeds": [100, 101],
        "zones": ["f1", "f2", "f3"],
        "shadows": [],
        "n_recorded": 2,
        "iac": IACConfig(meta=None).to_json(),
        "processor": processor(),
        "versions": config["versions"],
    }


def test_a_config_is_replaced_whole(tmp_path: Path) -> None:
    write_config(tmp_path, {"a": 1})
    with pytest.raises(TypeError):
        write_config(tmp_path, {"a": object()})
    assert json.loads((tmp_path / "config.json").read_text()) == {"a": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]


def test_cuts_are_named_and_in_raw_units() -> None:
    population = SyntheticPopulation(1, 900)
    for _ in range(900):
        population.decide()
    table = region_table(population.genealogy(), SPACE).to_pylist()
    root, first = table[:2]
    assert (root["parent"], root["cut_dimension"], root["n_examples"]) == (-1, "sound", 251)
    assert root["cut_value"] == pytest.approx(2 / 3)
    assert (first["parent"], first["depth"], first["born_step"]) == (0, 1, root["split_step"])
    wheels = [row for row in table if row["cut_dimension"] == "left_wheel"]
    assert wheels[0]["cut_value"] == pytest.approx(0.0)  # half way between -1 and 1
    leaves = [row for row in table if row["split_step"] == -1]
    assert {(row["cut_dimension"], row["cut_value"]) for row in leaves} == {(None, None)}


@given(
    n_agents=st.integers(1, 4),
    n_decisions=st.integers(1, 40),
    rows_per_part=st.integers(1, 50),
    window=st.integers(1, 12),
    data=st.data(),
)
@settings(max_examples=40)
def test_whatever_is_recorded_comes_back_and_windows_add_up(
    n_agents: int, n_decisions: int, rows_per_part: int, window: int, data: st.DataObject
) -> None:
    n_recorded = data.draw(st.integers(1, n_agents))
    flushed = data.draw(st.sets(st.integers(0, n_decisions)))
    population = SyntheticPopulation(n_agents, n_decisions, shadows={"knn": 2.0})
    decisions = [population.decide() for _ in range(n_decisions)]
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.object(run_recorder, "WINDOW", window),
        mock.patch.object(reader, "WINDOW", window),
        mock.patch.object(statistics, "WINDOW", window),
    ):
        recorder = Recorder(
            Path(folder),
            population,
            ZONES,
            rows_per_part=rows_per_part,
            n_recorded=n_recorded,
            log_every=1000,
        )
        for number, (step, zones) in enumerate(decisions):
            recorder.record(step, zones)
            if number in flushed:
                recorder.flush()
        recorder.flush()
        run = load_run(folder)
        table = run.steps
        errors = np.array([step.errors.numpy() for step, _ in decisions])
        zones_of = np.array([zones for _, zones in decisions])
        assert table.num_rows == n_decisions * n_recorded
        assert run.column("error").tolist() == errors[:, :n_recorded].tolist()
        assert run.column("zone").tolist() == zones_of[:, :n_recorded].tolist()
        sensors = np.array([step.sensors[:, 0].numpy() for step, _ in decisions])
        assert run.column("sensor/beam").tolist() == sensors[:, :n_recorded].tolist()
        counts, sums = run.window_sums.counts, run.window_sums.sums["error"]
        assert counts.shape == (-(-n_decisions // window), n_agents, 3)
        for zone in range(3):
            here = zones_of == zone
            assert counts[..., zone].sum(axis=0).tolist() == here.sum(axis=0).tolist()
            np.testing.assert_allclose(sums[..., zone].sum(axis=0), (errors * here).sum(axis=0))
        recorder._dashboard.close()


def test_logs_become_fewer_as_a_run_grows_old() -> None:
    """Each interval divides the next, so that logs stay due at whole numbers of the first."""
    ages = [1, 99_999, 100_000, 200_000, 799_999, 800_000]
    assert [log_interval(age, 100) for age in ages] == [100, 100, 200, 400, 800, 1600]
    n_logs = [sum(n % log_interval(n, 1) == 0 for n in range(1, 500 * 2**k)) for k in range(1, 7)]
    assert n_logs == [999 + 500 * k for k in range(6)]


def test_two_recorders_do_not_write_into_one_folder(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a", SyntheticPopulation(1, 1))
    with pytest.raises(BlockingIOError, match=r"a is in use: process \d+ on"):
        Recorder(tmp_path / "a", SyntheticPopulation(1, 1), resume=True)
    recorder.close()
    Recorder(tmp_path / "a", SyntheticPopulation(1, 1), resume=True).close()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_recorder_is_not_copied(tmp_path: Path, copied: Callable[[Any], Any]) -> None:
    recorder = Recorder(tmp_path / "a", SyntheticPopulation(1, 1))
    with pytest.raises(TypeError, match="a recorder must not be copied, since it writes into"):
        copied(recorder)
    recorder.close()


def test_seeds_that_no_column_holds_are_refused(tmp_path: Path) -> None:
    agents = SyntheticPopulation(1, 1)
    agents.seeds = (2**63,)
    with pytest.raises(ValueError, match="seeds must fit into 64 bits to be recorded, got 92233"):
        Recorder(tmp_path / "a", agents)
