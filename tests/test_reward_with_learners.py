"""Learning progress as a reward in the libraries and loops that people train with."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as of_vectors
from torch import nn

from tests.test_reward import SMALL, Echo, same
from torch_iac import ProgressReward, VectorProgressReward

LENGTH = 10
"""How many decisions an episode of these tests takes."""


def short() -> Echo:
    return Echo(LENGTH)


def rewarded(**arguments: Any) -> ProgressReward:
    return ProgressReward(short(), SMALL, scale=10.0, **arguments)


def progress_in(env: Any) -> ProgressReward:
    """Return the wrapper inside of others."""
    while not isinstance(env, ProgressReward):
        env = env.env
    return env


class TestStableBaselines3:
    """The recipes of docs/reward.md."""

    pytestmark = pytest.mark.filterwarnings("default")  # it has warnings of its own

    @pytest.fixture(autouse=True)
    def _needs_it(self) -> None:
        pytest.importorskip("stable_baselines3", reason="needs SB3: pip install 'torch_iac[sb3]'")

    def test_what_the_experts_have_learnt_outlasts_saving_and_loading(self, tmp_path: Path) -> None:
        from stable_baselines3 import SAC

        env = rewarded()
        sac = SAC("MlpPolicy", env, learning_starts=5, batch_size=4, seed=3, device="cpu")
        sac.learn(25)
        assert env.agent.seeds == (3,)
        assert env.agent.n_decisions == 25
        sac.save(tmp_path / "sac")
        torch.save(env.state(), tmp_path / "experts.pt")

        again = rewarded()
        again.load_state(torch.load(tmp_path / "experts.pt"))
        loaded = SAC.load(tmp_path / "sac", env=again, device="cpu")
        loaded.learn(15, reset_num_timesteps=False)
        assert again.agent.n_decisions == 40
        SAC.load(tmp_path / "sac", env=env, device="cpu").learn(15)
        assert env.agent.n_decisions == 40

    def test_each_world_of_a_vector_has_experts_of_its_own(self) -> None:
        from stable_baselines3.common.env_util import make_vec_env

        worlds = make_vec_env(
            short, n_envs=3, seed=7, wrapper_class=ProgressReward, wrapper_kwargs={"config": SMALL}
        )
        worlds.reset()
        worlds.step(np.zeros((3, 1), np.float32))
        assert [agent.seeds for agent in worlds.get_attr("agent")] == [(7,), (8,), (9,)]

    def test_evaluation_teaches_nothing(self) -> None:
        from stable_baselines3 import SAC
        from stable_baselines3.common.callbacks import EvalCallback
        from stable_baselines3.common.evaluation import evaluate_policy
        from stable_baselines3.common.monitor import Monitor

        env = rewarded(seed=0)
        sac = SAC("MlpPolicy", env, learning_starts=5, batch_size=4, seed=0, device="cpu")
        trial = Monitor(env.for_evaluation(short()))
        sac.learn(30, callback=EvalCallback(trial, n_eval_episodes=1, eval_freq=10, verbose=0))
        assert env.agent.n_decisions == 30
        before = env.state()
        mean, _ = evaluate_policy(sac, trial, n_eval_episodes=2)
        assert same(env.state(), before)
        assert np.isfinite(mean)
        worlds = sac.get_env()
        assert worlds is not None
        worlds.env_method("set_wrapper_attr", "learning", False)
        evaluate_policy(sac, worlds, n_eval_episodes=2)
        assert same(env.state(), before)
        worlds.env_method("set_wrapper_attr", "learning", True)
        assert env.learning

    def test_monitor_counts_the_rewards_of_what_it_is_put_around(self) -> None:
        from stable_baselines3.common.monitor import Monitor

        around, inside = Monitor(rewarded()), ProgressReward(Monitor(short()), SMALL)
        for env in (around, inside):
            env.reset(seed=0)
            rewards = []
            draw = np.random.default_rng(0)
            for _ in range(LENGTH):
                action = draw.uniform(0, 1, 1).astype(np.float32)
                _, reward, _, _, info = env.step(action)
                rewards.append(float(reward))
            told = float(np.sum(rewards)) if env is around else 7.0 * LENGTH
            assert info["episode"]["r"] == pytest.approx(told, abs=1e-5)

    def test_normalised_observations_are_the_learners_not_the_experts(self, tmp_path: Path) -> None:
        from stable_baselines3 import PPO
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.vec_env import VecNormalize

        def worlds() -> Any:
            return make_vec_env(rewarded, n_envs=2, seed=1)  # each in a Monitor, from the outside

        env = VecNormalize(worlds())
        ppo = PPO("MlpPolicy", env, n_steps=32, batch_size=16, n_epochs=1, seed=1, device="cpu")
        ppo.learn(128)
        experts = env.env_method("get_wrapper_attr", "state")
        for agent in env.get_attr("agent"):
            assert agent.n_decisions == 64
            held = agent.examples.situations[: agent.examples.n_rows]
            assert held[held.isfinite()].max() <= 1  # scaled by the world's own bounds
        assert env.get_original_reward() != pytest.approx(env.normalize_reward(np.ones(2)))
        ppo.save(tmp_path / "ppo")
        env.save(str(tmp_path / "normalisation.pkl"))
        torch.save(env.env_method("state"), tmp_path / "experts.pt")
        assert len(experts) == 2

        again = VecNormalize.load(str(tmp_path / "normalisation.pkl"), worlds())
        for number, state in enumerate(torch.load(tmp_path / "experts.pt")):
            again.env_method("load_state", state, indices=[number])
        assert again.ret_rms.mean == env.ret_rms.mean
        loaded = PPO.load(tmp_path / "ppo", env=again, device="cpu")
        loaded.learn(64, reset_num_timesteps=False)
        assert [agent.n_decisions for agent in again.get_attr("agent")] == [96, 96]


class Policy(nn.Module):
    """An actor and a critic, as in a script of a single file."""

    def __init__(self) -> None:
        super().__init__()
        self.mean = nn.Sequential(nn.Linear(1, 16), nn.Tanh(), nn.Linear(16, 1))
        self.value = nn.Sequential(nn.Linear(1, 16), nn.Tanh(), nn.Linear(16, 1))
        self.spread = nn.Parameter(torch.zeros(1))

    def of(self, sensors: torch.Tensor) -> Any:
        """Return the distribution of actions at some sensors."""
        return torch.distributions.Normal(self.mean(sensors), self.spread.exp())


def test_a_loop_in_the_style_of_cleanrl_learns_from_it() -> None:
    """PPO over a vector whose worlds have the usual wrappers, with ends in `final_info`."""
    n_worlds, n_steps, gamma = 4, 32, 0.9

    def make() -> gym.Env[Any, Any]:
        return gym.wrappers.RecordEpisodeStatistics(short())

    torch.manual_seed(0)
    worlds = SyncVectorEnv([make] * n_worlds, autoreset_mode=AutoresetMode.SAME_STEP)
    progress = VectorProgressReward(worlds, SMALL, scale=10.0)
    envs: Any = of_vectors.ClipAction(progress)  # around it, for the experts want bounded actions
    policy = Policy()
    optimiser = torch.optim.Adam(policy.parameters(), lr=0.01)
    first = [weight.clone() for weight in policy.parameters()]
    next_obs, _ = envs.reset(seed=1)
    ends: list[int] = []
    outcomes, moments = [], 0
    for _ in range(3):
        obs, actions, logs, rewards, dones = [], [], [], [], []
        for _ in range(n_steps):
            obs.append(torch.tensor(next_obs))
            with torch.no_grad():
                chosen = policy.of(obs[-1])
                action = chosen.sample()
            next_obs, reward, terminated, truncated, infos = envs.step(action.numpy())
            moments += 1
            actions.append(action)
            logs.append(chosen.log_prob(action).sum(1))
            rewards.append(torch.tensor(reward, dtype=torch.float32))
            dones.append(torch.tensor(terminated | truncated, dtype=torch.float32))
            assert progress.last is not None
            outcomes.append(progress.last.outcomes[:, 0])
            if "final_info" in infos:
                ended = infos["final_info"]["_episode"]
                ends += infos["final_info"]["episode"]["l"][ended].tolist()
                assert infos["final_info"]["episode"]["r"][ended].tolist() == [7.0 * LENGTH] * 4
        returns = torch.zeros(n_steps, n_worlds)
        with torch.no_grad():
            following = policy.value(torch.tensor(next_obs))[:, 0]
        for step in reversed(range(n_steps)):
            following = rewards[step] + gamma * (1 - dones[step]) * following
            returns[step] = following
        all_obs, all_actions, all_logs = (torch.cat(of) for of in (obs, actions, logs))
        for _ in range(2):
            values = policy.value(all_obs)[:, 0]
            gain = (returns.flatten() - values).detach()
            ratio = (policy.of(all_obs).log_prob(all_actions).sum(1) - all_logs).exp()
            surrogate = torch.min(ratio * gain, ratio.clamp(0.8, 1.2) * gain)
            loss = -surrogate.mean() + (returns.flatten() - values).square().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    assert moments == progress.agent.n_decisions == 96
    assert ends == [LENGTH] * 36
    assert torch.stack(rewards).std() > 0
    assert 0.5 not in torch.stack(outcomes)  # what a new episode begins with is no outcome
    assert any((old != new).any() for old, new in zip(first, policy.parameters(), strict=True))


def test_worlds_may_be_reset_by_hand_where_their_episodes_end() -> None:
    worlds = SyncVectorEnv([short, Echo], autoreset_mode=AutoresetMode.DISABLED)
    progress = VectorProgressReward(worlds, SMALL)
    progress.reset(seed=0)
    begins = np.array([True, True])
    for _ in range(3 * LENGTH):
        *_, terminated, _, _ = progress.step(np.full((2, 1), 0.25, np.float32))
        assert progress.last is not None
        assert (progress.last.outcomes == 0.25).all()
        assert progress.last.sensors[:, 0].tolist() == np.where(begins, 0.5, 0.25).tolist()
        begins = terminated
        if terminated.any():
            progress.reset(options={"reset_mask": terminated})
    assert progress.agent.n_decisions == 3 * LENGTH


def test_each_world_may_normalise_outside_its_own_experts() -> None:
    """As where every world of a vector is wrapped by itself."""

    def make() -> gym.Env[Any, Any]:
        env: Any = ProgressReward(short(), SMALL)
        env = gym.wrappers.RecordEpisodeStatistics(gym.wrappers.ClipAction(env))
        env = gym.wrappers.NormalizeReward(gym.wrappers.NormalizeObservation(env))
        box = gym.spaces.Box(-10.0, 10.0, (1,), np.float32)
        return gym.wrappers.TransformObservation(env, lambda seen: np.clip(seen, -10, 10), box)

    envs = SyncVectorEnv([make] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=4)
    for _ in range(LENGTH):
        *_, info = envs.step(np.full((2, 1), 3.0, np.float32))
    assert [progress_in(env).agent.seeds for env in envs.envs] == [(4,), (5,)]
    assert info["final_info"]["iac"]["world_reward"].tolist() == [7.0, 7.0]
    assert info["final_info"]["episode"]["l"].tolist() == [LENGTH, LENGTH]
