"""Runs for the Rerun viewer, read back by Rerun itself."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.synthetic_run import ZONES, write_run
from torch_iac import Experiment, IACConfig
from torch_iac.export.rerun_file import poses_of, save_rerun
from torch_iac.runs.reader import Run, load_run

N_DECISIONS, BEAM_NOISE = 60, 0.01


@pytest.fixture(scope="module", params=["kinematic", "toyroom"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    config = IACConfig(max_examples=20, window=8, delay=8)
    folder = tmp_path_factory.mktemp("runs") / request.param
    experiment = Experiment(
        world=request.param, config=config, seeds=(0, 3), steps=N_DECISIONS, log_every=50
    )
    return experiment.run(folder)


def test_beams_from_where_the_robot_was_end_at_the_walls(run: Run) -> None:
    """An independent check of places and headings: what the beams read."""
    poses = poses_of(run, agent=1)
    assert poses is not None
    for beam, angle in ((0, 0.0), (2, np.pi / 2)):
        way = np.stack([np.cos(poses.heading + angle), np.sin(poses.heading + angle)], -1)
        to_walls = (np.sign(way) * poses.room.side / 2 - poses.robot) / way
        read = run.column(f"sensor/wall_{beam}")[:, 1]
        assert np.abs(to_walls.min(axis=1) - read).max() < 5 * BEAM_NOISE
    seen = run.column("sensor/toy_distance")[:, 1]
    centres = np.linalg.norm(poses.toy - poses.robot, axis=1)
    far = seen > 0.2
    surface = centres[far] - poses.room.toy_radius
    assert np.abs(surface - seen[far]).max() < 5 * BEAM_NOISE


def test_a_file_holds_everything_on_one_time_line(run: Run, tmp_path: Path) -> None:
    chunk: Any = pytest.importorskip("rerun.chunk", reason="pip install 'torch_iac[rerun]'")
    path = save_rerun(run, tmp_path / "new" / "robot.rrd", agent=1)
    rows: dict[str, int] = {}
    for part in chunk.RrdReader(path).store().stream().to_chunks():
        if not part.is_static:
            assert part.timeline_names == ["decision"]
            rows[part.entity_path] = rows.get(part.entity_path, 0) + part.num_rows
    n_cuts = sum(row["split_step"] >= 0 for row in run.family(1).to_pylist())
    assert n_cuts > 0
    assert rows["/cuts"] == n_cuts
    every = ["room/robot", "room/toy", "room/robot/beams", "regions", "progress/of_the_region"]
    every += ["error/main", "error/expected", "n_regions/n_regions", "actions/sound"]
    every += [f"zones/{zone}" for zone in ZONES]
    assert {rows[f"/{name}"] for name in every} == {N_DECISIONS}


def test_another_world_has_regions_and_numbers_but_no_room(tmp_path: Path) -> None:
    chunk: Any = pytest.importorskip("rerun.chunk", reason="pip install 'torch_iac[rerun]'")
    run = load_run(write_run(tmp_path / "run", n_decisions=700, shadows={"mlp": 2.0}))
    store = chunk.RrdReader(save_rerun(run, tmp_path / "a.rrd")).store()
    paths = {part.entity_path for part in store.stream().to_chunks()}
    assert {"/regions", "/error/mlp", "/cuts"} <= paths
    assert not any(path.startswith("/room") for path in paths)


def test_a_file_must_be_an_rrd(run: Run, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a file for Rerun must be a \.rrd, got .*a\.mp4"):
        save_rerun(run, tmp_path / "a.mp4")
