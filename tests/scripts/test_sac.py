"""SAC maximises learning progress: what it gets is the reward, and the whole run is kept."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.analysis import generalisation
from torch_iac.runs.reader import load_run
from torch_iac.toy_room import WORLDS

pytest.importorskip("stable_baselines3", reason="needs SB3: pip install 'torch_iac[sb3]'")
pytestmark = pytest.mark.filterwarnings("default")  # SB3 has warnings of its own

SMALL = iac.IACConfig(max_examples=10, window=4, delay=4)


def test_sac_is_given_the_experts_progress() -> None:
    from stable_baselines3 import SAC

    env = iac.ProgressReward(
        gym.make(WORLDS["toyroom"]), SMALL, outcomes=["toy_distance"], scale=100.0
    )
    sac = SAC("MlpPolicy", env, learning_starts=30, seed=0, device="cpu")
    seen = []

    def keep(here: dict[str, Any], _: Any) -> bool:
        seen.append(here["infos"][0]["iac"])
        return True

    sac.learn(40, callback=keep)
    assert sac.replay_buffer is not None
    rewards = sac.replay_buffer.rewards[:40, 0]
    assert env.agent.n_decisions == len(seen) == 40
    assert [made["world_reward"] for made in seen] == [0.0] * 40
    # A region's progress, once it learnt, is what it is when its next action is chosen.
    for region in {made["region"] for made in seen}:
        (mine,) = np.nonzero([made["region"] == region for made in seen])
        told = [100 * seen[number]["progress"] for number in mine]
        np.testing.assert_allclose(rewards[mine][:-1], told[1:], rtol=1e-5)
    assert np.abs(rewards).max() > 0.1
    env.close()


def test_a_robot_that_sac_drives_leaves_a_run_like_any_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scripts.studies.sac import Learner, maximise

    monkeypatch.setattr(generalisation, "N_TESTED", 5)
    experiment = iac.Experiment(seeds=(3,), steps=40, test_every=20)
    maximise(Learner(gamma=0.5, learning_starts=20, batch_size=8), experiment, tmp_path / "a")
    run = load_run(tmp_path / "a")
    assert run.n_decisions == 40
    assert len(np.unique(run.column("zone")[:, 0])) == 3
    steps, errors = generalisation.tests_of([run], "met", "absolute")
    assert steps.tolist() == [20, 40]
    assert errors.shape == (2, 1)
    assert not np.allclose(errors[0], errors[1])
