"""Transitions set aside, and how well robots predict them."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pyarrow as pa
import pytest

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac import IAC, SensorimotorSpace
from torch_iac.analysis.generalisation import (
    TESTS,
    Transitions,
    collect,
    errors_on,
    load_tests,
    plateau,
    record_tests,
)
from torch_iac.runs.reader import Run

WORLDS = ["torch_iac_envs/ToyRoomKinematic-v0", "torch_iac_envs/ToyRoom-v0"]
F2, F3 = 1, 2


def collected(world: str, n: int, zone: int | None, *, anew: bool = False) -> Transitions:
    env = gym.make_vec(world, num_envs=2)
    space = SensorimotorSpace.from_env(env, ["toy_distance"])
    found = collect(env, space, n, seed=3, zone=zone, anew=anew)
    env.close()
    return found


@pytest.mark.parametrize("world", WORLDS)
def test_transitions_are_of_the_zone_that_is_asked_for(world: str) -> None:
    found = collected(world, 15, F3)
    assert found.actions.shape == (15, 3)
    assert found.sensors.shape == (15, 11)
    assert (found.actions[:, 2] > 2 / 3).all()
    assert (found.outcomes < 0.1).all()  # the toy has jumped into the robot


@pytest.mark.parametrize("world", WORLDS)
def test_the_same_seed_collects_the_same(world: str) -> None:
    one, other = (collected(world, 5, F2, anew=True) for _ in range(2))
    for name, values in vars(one).items():
        np.testing.assert_array_equal(values, getattr(other, name))


@pytest.mark.parametrize("world", WORLDS)
def test_a_life_goes_on_or_starts_anew(world: str) -> None:
    """In a life that goes on, what comes of an action is what the next one meets."""

    def follows(anew: bool) -> np.ndarray:
        found = collected(world, 20, None, anew=anew)
        distance = found.sensors[2:, 8]  # of two worlds, one after the other
        return np.asarray(distance == found.outcomes[:-2, 0])

    assert follows(anew=False).all()
    assert not follows(anew=True).any()


def test_a_zone_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch_iac.analysis.generalisation.PATIENCE", 2)
    with pytest.raises(ValueError, match="zone must be one that random actions meet, got 7"):
        collected(WORLDS[0], 2, 7)


def test_robots_that_know_nothing_predict_the_middle(space: SensorimotorSpace) -> None:
    """Of an outcome in [-1, 3], with 1 in the middle: 0 is off by a quarter, 3 by a half."""
    nothing, outcomes = np.zeros((2, 2), np.float32), np.array([[0.0], [3.0]], np.float32)
    transitions = Transitions(nothing, nothing, outcomes)
    found = errors_on(transitions, IAC(space, seeds=[1, 2]))
    np.testing.assert_allclose(found.absolute, [0.375, 0.375])
    np.testing.assert_allclose(found.squared, [0.15625, 0.15625])


def test_what_was_learnt_is_predicted(space: SensorimotorSpace) -> None:
    agent = IAC(space)
    sensors = np.array([[1.0, 2.0]], np.float32)
    action = agent.act(sensors)
    agent.observe(np.array([[1.0, 2.5]], np.float32))
    learnt = Transitions(action, sensors, np.array([[2.5]], np.float32))
    assert errors_on(learnt, agent).absolute.item() == pytest.approx(0, abs=1e-6)


def test_a_test_is_a_file_of_its_own_and_is_written_once_more_after_a_kill(
    space: SensorimotorSpace, tmp_path: Path
) -> None:
    """A run that was killed goes on from an earlier checkpoint, and comes to the same."""
    sensors = np.array([[1.0, 2.0]], np.float32)
    sets = {"met": Transitions(sensors * 0, sensors, sensors[:, :1])}

    def tested(n_decisions: int) -> pa.Table:
        agent = IAC(space)
        for _ in range(n_decisions):
            agent.act(sensors)
            agent.observe(sensors)
        record_tests(agent, sets, tmp_path)
        return load_tests(Run(tmp_path))

    with pytest.raises(FileNotFoundError, match="holds no generalisation tests"):
        load_tests(Run(tmp_path))
    assert tested(10)["step"].to_pylist() == [10]
    first = next((tmp_path / TESTS).iterdir())
    before = first.stat().st_mtime_ns
    found = tested(20)
    assert found["step"].to_pylist() == [10, 20]
    assert first.stat().st_mtime_ns == before
    assert tested(9)["step"].to_pylist() == [9, 10, 20]
    assert tested(20).slice(1) == found


def test_a_plateau_begins_where_errors_cease_to_change() -> None:
    falling = np.array([8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0])
    errors = np.stack([falling, 10 * np.arange(7.0)], axis=1)
    np.testing.assert_array_equal(plateau(errors, 3, 0.01), [3, np.nan])
    assert np.isnan(plateau(errors, 8, 0.01)).all()
