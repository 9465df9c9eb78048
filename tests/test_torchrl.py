"""Learning progress as TorchRL's intrinsic reward: the same as the wrapper's, in any batch."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from tests.test_reward import SMALL, Echo, same
from torch_iac import IAC, ProgressReward, SensorimotorSpace
from torch_iac.reward import When

pytest.importorskip("torchrl", reason="needs TorchRL: pip install 'torch_iac[torchrl]'")
pytestmark = pytest.mark.filterwarnings("default")  # it has warnings of its own

LENGTH = 7
"""How many decisions an episode takes."""


class Calm(Echo):
    """An echo whose sensor reads what the action's size is."""

    def step(self, action: Any) -> Any:
        observation, *rest = super().step(np.abs(action))
        return observation.copy(), *rest

    def reset(self, **arguments: Any) -> Any:
        observation, info = super().reset(**arguments)
        return observation.copy(), info


def base(length: int = LENGTH) -> Any:
    from torchrl.envs import GymWrapper

    return GymWrapper(Calm(length))


def several(kind: str) -> Any:
    """Return two worlds whose episodes end at different times."""
    from torchrl.envs import GymWrapper, SerialEnv

    if kind == "gymnasium":
        return GymWrapper(
            gym.vector.SyncVectorEnv(
                [lambda: Calm(LENGTH), lambda: Calm(LENGTH - 2)],
                autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
            )
        )
    return SerialEnv(2, [base, partial(base, LENGTH - 2)])


def agent_of(*seeds: int) -> IAC:
    return IAC(SensorimotorSpace.from_env(Calm()), SMALL, seeds)


def rewarded(world: Any, agent: IAC, *others: Any, **arguments: Any) -> Any:
    from torchrl.envs import Compose, TransformedEnv

    from torch_iac.torchrl import ProgressTransform

    return TransformedEnv(world, Compose(ProgressTransform(agent, **arguments), *others))


def wrappers_rewards(
    actions: torch.Tensor, seed: int, when: When, length: int = LENGTH
) -> list[float]:
    """Return what `ProgressReward` pays for actions, shape `(T, 1)`."""
    env = ProgressReward(Calm(length), SMALL, seed=seed, when=when, scale=3.0)
    env.reset()
    rewards = []
    for action in actions.numpy():
        _, reward, terminated, _, _ = env.step(action)
        rewards.append(float(np.float32(reward)))
        if terminated:
            env.reset()
    return rewards


@pytest.mark.parametrize("when", ["learnt", "chosen"])
def test_the_intrinsic_reward_is_the_wrappers(when: When) -> None:
    agent = agent_of(4)
    env = rewarded(base(), agent, when=when, scale=3.0)
    data = env.rollout(60, break_when_any_done=False)
    rewards = data["next", "intrinsic_reward"][:, 0].tolist()
    assert rewards == wrappers_rewards(data["action"], 4, when)
    assert np.std(rewards) > 0
    assert (data["next", "reward"] == 7).all()
    assert agent.n_decisions == 60


@pytest.mark.parametrize("kind", ["serial", "gymnasium"])
def test_each_world_of_a_batch_has_experts_of_its_own(kind: str) -> None:
    world = several(kind)
    env = rewarded(world, agent_of(4, 5), scale=3.0)
    data = env.rollout(40, break_when_any_done=False)
    rewards = data["next", "intrinsic_reward"]
    assert rewards.shape == (2, 40, 1)
    for number, length in enumerate((LENGTH, LENGTH - 2)):
        alone = wrappers_rewards(data["action"][number], 4 + number, "learnt", length)
        assert rewards[number, :, 0].tolist() == alone
    world.close()


@pytest.mark.parametrize("n_worlds", [1, 2])
def test_torchrl_finds_nothing_to_complain_about(n_worlds: int) -> None:
    from torchrl.envs import check_env_specs

    world = base() if n_worlds == 1 else several("serial")
    check_env_specs(rewarded(world, agent_of(*range(n_worlds))))


def test_later_transforms_of_observations_are_not_the_experts() -> None:
    from torchrl.envs import ObservationNorm, TransformedEnv

    norm = partial(ObservationNorm, loc=5.0, scale=0.1, in_keys=["observation"])
    plain = rewarded(base(), agent_of(0))
    composed = rewarded(base(), agent_of(0), norm())
    nested = TransformedEnv(rewarded(base(), agent_of(0)), norm(), auto_unwrap=False)
    expected = None
    for env in (plain, composed, nested):
        torch.manual_seed(0)
        data = env.rollout(30, break_when_any_done=False)
        rewards = data["next", "intrinsic_reward"].tolist()
        expected = expected or rewards
        assert rewards == expected
        assert (data["observation"] > 4).all() == (env is not plain)


def test_it_can_be_the_reward_itself() -> None:
    data = rewarded(base(), agent_of(4), scale=3.0, out_keys=["reward"]).rollout(
        30, break_when_any_done=False
    )
    assert data["next", "reward"][:, 0].tolist() == wrappers_rewards(data["action"], 4, "learnt")


def test_for_evaluation_the_experts_judge_and_do_not_learn() -> None:
    agent = agent_of(0)
    env = rewarded(base(), agent)
    env.rollout(30, break_when_any_done=False)
    before = agent.state()
    env.transform[0].learning = False
    data = env.rollout(30, break_when_any_done=False)
    assert data["next", "intrinsic_reward"].std() > 0
    assert same(agent.state(), before)
    env.transform[0].learning = True
    env.rollout(1)
    assert agent.n_decisions == 31


def test_what_is_learnt_is_in_the_state_dict(tmp_path: Path) -> None:
    agent, other = agent_of(0), agent_of(0)
    env, again = rewarded(base(), agent), rewarded(base(), other)
    env.rollout(30, break_when_any_done=False)
    torch.save(env.state_dict(), tmp_path / "env.pt")
    again.load_state_dict(torch.load(tmp_path / "env.pt"))
    assert same(other.state(), agent.state())


def test_a_collector_collects_it() -> None:
    from torchrl.collectors import Collector

    agent = agent_of(0, 1)
    world = several("serial")
    collector = Collector(
        rewarded(world, agent, scale=3.0), None, frames_per_batch=20, total_frames=80
    )
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    data: Any = torch.cat(batches, dim=1)
    assert agent.n_decisions == 40
    for number, length in enumerate((LENGTH, LENGTH - 2)):
        rewards = data["next", "intrinsic_reward"][number, :, 0].tolist()
        assert rewards == wrappers_rewards(data["action"][number], number, "learnt", length)


def test_there_must_be_an_agent_for_each_world() -> None:
    with pytest.raises(ValueError, match=r"as many agents as there are worlds \(2\), got 1"):
        rewarded(several("serial"), agent_of(0)).rollout(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"when": "later"}, "when must be learnt or chosen, got later"),
        ({"in_keys": ["a", "b"]}, r"in_keys must be a list of one key, got \['a', 'b'\]"),
        ({"out_keys": "reward"}, "out_keys must be a list of one key, got 'reward'"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    from torch_iac.torchrl import ProgressTransform

    make: Callable[..., Any] = ProgressTransform
    with pytest.raises(ValueError, match=message):
        make(agent_of(0), **arguments)
