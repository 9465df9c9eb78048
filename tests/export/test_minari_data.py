"""Transitions as a Minari data set, read back by Minari itself."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from torch_iac import Experiment, load_run
from torch_iac.export.minari_data import episodes_of, save_minari
from torch_iac.runs.reader import Run

N_DECISIONS = 30
WHY = "needs Minari: pip install 'torch_iac[minari]'"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Two robots; of their sensors, one is predicted."""
    folder = tmp_path_factory.mktemp("runs") / "room"
    experiment = Experiment(world="kinematic", seeds=(0, 1), steps=N_DECISIONS)
    return experiment.run(folder)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A world whose episodes end after 12 decisions; all sensors are predicted."""
    options = {"max_episode_steps": 12}
    experiment = Experiment(world="Pendulum-v1", world_options=options, steps=N_DECISIONS)
    return experiment.run(tmp_path_factory.mktemp("runs") / "pendulum")


def test_an_episode_that_does_not_end_is_the_run_but_its_last_outcome(room: Run) -> None:
    (episode,) = episodes_of(room, agent=1)
    sensors = room.columns([f"sensor/{of.name}" for of in room.space.sensors])[:, 1]
    actions = room.columns([f"action/{of.name}" for of in room.space.actions])[:, 1]
    assert np.array_equal(episode.observations, sensors)
    assert np.array_equal(episode.actions, actions[:-1])
    assert np.array_equal(episode.progress, room.column("progress")[:-1, 1])


def test_episodes_end_where_the_worlds_do_with_the_last_outcome(pendulum: Run) -> None:
    episodes = episodes_of(pendulum)
    assert [len(episode.actions) for episode in episodes] == [12, 12, 6]
    outcomes = pendulum.columns([f"outcome/{of.name}" for of in pendulum.space.outcomes])[:, 0]
    for episode, end in zip(episodes, (11, 23, 29), strict=True):
        assert np.array_equal(episode.observations[-1], outcomes[end])


@pytest.mark.parametrize("is_folder", [True, False], ids=["folder", "name"])
def test_minari_reads_what_was_written(
    room: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_folder: bool
) -> None:
    minari: Any = pytest.importorskip("minari", reason=WHY)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "own"))
    target = str(tmp_path / "mine" / "curious-v0") if is_folder else "rooms/curious-v0"
    save_minari(room, target)
    if is_folder:
        assert minari.list_local_datasets() == {}
        monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "mine"))
    data = minari.load_dataset("curious-v0" if is_folder else target)
    assert (data.total_episodes, data.total_steps) == (2, 2 * (N_DECISIONS - 1))
    for agent, read in enumerate(data.iterate_episodes()):
        (written,) = episodes_of(room, agent)
        assert np.array_equal(read.observations, written.observations)
        assert np.array_equal(read.actions, written.actions)
        assert np.array_equal(read.rewards, written.progress)
        assert not read.terminations.any()
        assert np.flatnonzero(read.truncations).tolist() == [N_DECISIONS - 2]
        assert all(data.observation_space.contains(of) for of in read.observations)
    with pytest.raises(ValueError, match=r"a data set must have a new name, got .*curious-v0"):
        save_minari(load_run(room.folder), target)


@pytest.mark.parametrize("name", ["curious", "curious-v", "a b-v0", "./curious", "-v0/"])
def test_a_name_must_be_one_for_minari(room: Run, name: str) -> None:
    pytest.importorskip("minari", reason=WHY)
    with pytest.raises(ValueError, match="must be named as toyroom/curious-v0 is, got"):
        save_minari(room, name)
