"""The loop that joins a population and its worlds."""

import io
import logging
import re
import sys
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from torch_iac import IAC, IACConfig, SensorimotorSpace, training
from torch_iac.runs.checkpoint import Checkpoints, identity
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.recorder import Recorder
from torch_iac.training import train

CONFIG = IACConfig(n_candidates=5, max_examples=20, window=8, delay=8)
"""Splits often, so that a short run shows much."""

Sensors = NDArray[np.float32]


class Echo(gym.Env[Sensors, Sensors]):
    """One sensor, which reads the action: exactly if it is positive, and else with noise."""

    metadata: dict[str, Any] = {"zone_names": ("noise", "echo")}  # noqa: RUF012 - gymnasium's type

    def __init__(self) -> None:
        self.action_space = self.observation_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Sensors, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return self.np_random.uniform(-1, 1, 1).astype(np.float32), {}

    def step(self, action: Sensors) -> tuple[Sensors, SupportsFloat, bool, bool, dict[str, Any]]:
        noise = self.np_random.uniform(-1, 1, 1).astype(np.float32)
        is_echo = bool(action[0] > 0)
        return action if is_echo else noise, 0.0, False, False, {"zone": int(is_echo)}


Worlds = VectorEnv[Any, Any, Any]


def sync_worlds(n_worlds: int) -> Worlds:
    return SyncVectorEnv([Echo] * n_worlds)


def async_worlds(n_worlds: int) -> Worlds:
    return AsyncVectorEnv([Echo] * n_worlds)


def population(worlds: Worlds, seeds: list[int]) -> IAC:
    return IAC(SensorimotorSpace.from_env(worlds), CONFIG, seeds)


def live(folder: Path, worlds: Worlds, seeds: list[int], n_decisions: int = 120) -> Run:
    agent = population(worlds, seeds)
    with Recorder(folder, agent, Echo.metadata["zone_names"]) as recorder:
        train(agent, worlds, n_decisions, recorder)
    worlds.close()
    return load_run(folder)


def test_worlds_in_other_processes_give_the_same_run(tmp_path: Path) -> None:
    here = live(tmp_path / "here", sync_worlds(2), [3, 4])
    there = live(tmp_path / "there", async_worlds(2), [3, 4])
    assert here.n_decisions == 120
    assert there.steps == here.steps
    assert there.regions == here.regions


def test_worlds_start_from_the_seeds_of_their_agents(tmp_path: Path) -> None:
    three = live(tmp_path / "three", sync_worlds(3), [5, 6, 5])
    alone = live(tmp_path / "alone", sync_worlds(1), [6])
    assert three.table(["sensor/sensor_0", "error"], agent=1) == alone.table(
        ["sensor/sensor_0", "error"]
    )
    assert three.table(["sensor/sensor_0"], agent=0) == three.table(["sensor/sensor_0"], agent=2)
    assert three.table(["sensor/sensor_0"], agent=0) != three.table(["sensor/sensor_0"], agent=1)


def test_what_is_recorded_is_what_happened(tmp_path: Path) -> None:
    """The zones are those of the actions beside them, and a sensor is what the last step left."""
    run = live(tmp_path, sync_worlds(2), [0, 1])
    actions, zones = run.column("action/action_0"), run.column("zone")
    assert (zones == (actions > 0)).all()
    assert (run.column("outcome/sensor_0")[zones == 1] == actions[zones == 1]).all()
    assert (run.column("sensor/sensor_0")[1:] == run.column("outcome/sensor_0")[:-1]).all()


def test_nobody_need_record() -> None:
    worlds = sync_worlds(1)
    agent = population(worlds, [0])
    train(agent, worlds, 30)
    train(agent, worlds, 42)  # goes on with what it knows, in a world made anew
    assert agent.n_decisions == 42
    assert train(agent, worlds, 42)
    with pytest.raises(ValueError, match=r"must be at least those already taken \(42\), got 41"):
        train(agent, worlds, 41)


@pytest.mark.parametrize("n_worlds", [1, 3])
def test_every_agent_needs_a_world_and_every_world_an_agent(n_worlds: int) -> None:
    agent = population(sync_worlds(2), [0, 1])
    rule = r"env must have as many worlds as there are agents \(2\), got"
    with pytest.raises(ValueError, match=f"{rule} {n_worlds}"):
        train(agent, sync_worlds(n_worlds), 10)
    assert agent.n_decisions == 0


@pytest.mark.parametrize("n_decisions", [0, -1])
def test_there_must_be_decisions(n_decisions: int) -> None:
    worlds = sync_worlds(1)
    with pytest.raises(ValueError, match=f"n_decisions must be at least 1, got {n_decisions}"):
        train(population(worlds, [0]), worlds, n_decisions)


def test_where_there_is_no_terminal_the_log_speaks_now_and_then(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "SECONDS_BETWEEN_LINES", 0.0)
    worlds = sync_worlds(1)
    with caplog.at_level(logging.INFO, logger="torch_iac.training"):
        train(population(worlds, [0]), worlds, 3)
    assert len(caplog.messages) == 3
    for number, message in enumerate(caplog.messages, start=1):
        assert re.fullmatch(rf"{number} of 3 decisions, [\d.e+]+ a second", message)


def test_the_log_says_what_the_robots_do(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "SECONDS_BETWEEN_LINES", 0.0)
    with caplog.at_level(logging.INFO, logger="torch_iac.training"):
        live(tmp_path, sync_worlds(2), [0, 1], 3)
    for message in caplog.messages:
        assert re.search(r" a second: .*error [\d.e-]+, 1 region, best 0.* progress 0", message)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("seconds", "is_shown"), [(0.0, True), (1e9, False)])
def test_below_the_progress_bar_stands_what_the_robots_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seconds: float, is_shown: bool
) -> None:
    looks: list[int] = []

    def look(_: Recorder) -> str:
        looks.append(0)
        return "echo 100%"

    monkeypatch.setattr(training, "SECONDS_BETWEEN_LOOKS", seconds)
    monkeypatch.setattr(Recorder, "present", look)
    monkeypatch.setattr(sys, "stderr", Terminal())
    live(tmp_path, sync_worlds(1), [0], 5)
    assert isinstance(sys.stderr, Terminal)
    shown = sys.stderr.getvalue()
    assert "/5 [" in shown
    assert ("echo 100%" in shown) is is_shown
    assert len(looks) == 5 * is_shown


class Ladder(gym.Env[Sensors, Sensors]):
    """Its sensor counts up; at 5 it is over, and it starts again at 0."""

    def __init__(self) -> None:
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gym.spaces.Box(0.0, 5.0, (1,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Sensors, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.rung = 0
        return np.array([0.0], np.float32), {}

    def step(self, _: Sensors) -> tuple[Sensors, SupportsFloat, bool, bool, dict[str, Any]]:
        self.rung += 1
        return np.array([self.rung], np.float32), 0.0, self.rung == 5, False, {}


def test_where_an_episode_ends_the_outcome_is_its_end_and_the_next_action_sees_the_beginning(
    tmp_path: Path,
) -> None:
    worlds = SyncVectorEnv([Ladder] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    agent = population(worlds, [0, 1])
    with Recorder(tmp_path, agent) as recorder:
        train(agent, worlds, 12, recorder)
    run = load_run(tmp_path)
    assert run.column("sensor/sensor_0")[:, 1].tolist() == [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1]
    assert run.column("outcome/sensor_0")[:, 1].tolist() == [1, 2, 3, 4, 5, 1, 2, 3, 4, 5, 1, 2]


def test_a_world_that_would_show_its_beginning_as_an_outcome_is_refused() -> None:
    worlds = SyncVectorEnv([Ladder])
    with pytest.raises(ValueError, match="must be made with autoreset_mode SAME_STEP, got"):
        train(population(worlds, [0]), worlds, 12)


def test_a_world_that_cannot_be_saved_is_refused_when_it_should_be(tmp_path: Path) -> None:
    worlds = sync_worlds(1)
    agent = population(worlds, [0])
    checkpoints = Checkpoints(tmp_path, identity(agent))
    with pytest.raises(ValueError, match="a world must have get_state and set_state, or worlds"):
        train(agent, worlds, 12, checkpoints=checkpoints)


def test_a_short_run_is_silent(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    worlds = sync_worlds(1)
    with caplog.at_level(logging.INFO):
        train(population(worlds, [0]), worlds, 5)
    assert caplog.messages == []
    assert capfd.readouterr() == ("", "")
