"""The engine against the oracle on the real world: 5 seeds, 3,000 decisions each."""

import gymnasium as gym
import pytest

import torch_iac_envs  # noqa: F401 - registers the world
from tests.agreement import check_step, oracle_of
from torch_iac import IAC, IACConfig, SensorimotorSpace


@pytest.mark.parametrize("seed", range(5))
def test_the_toy_rooms_robot_is_the_oracles(seed: int) -> None:
    env = gym.make_vec("torch_iac_envs/ToyRoom-v0", num_envs=1)
    space = SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    agent, robot = IAC(space, seeds=[seed]), oracle_of(IACConfig())
    sensors, _ = env.reset(seed=seed)
    for _ in range(3_000):
        sensors, *_ = env.step(agent.act(sensors))
        check_step(space, robot, agent.observe(sensors))
    env.close()
    assert robot.n_regions > 20
