"""What a GPU needs of the code, tested without one.

A tensor on the device `meta` has a shape but no values. As on a GPU, it cannot be mixed with one on
the processor; and whoever needs a value of it fails, where on a GPU they would have to wait.
"""

from typing import Any

import gymnasium as gym
import pytest
import torch
from torch import Tensor

import torch_iac.agent
import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac import (
    IAC,
    Curriculum,
    Error,
    GlobalProgress,
    HybridExperts,
    IACConfig,
    Improvement,
    ImprovementPredictor,
    KNNExperts,
    MetaPredictor,
    MLPExperts,
    NetworkExperts,
    Novelty,
    Proportional,
    SensorimotorSpace,
    Softmax,
)

KINEMATIC = "torch_iac_envs/ToyRoomKinematic-v0"

CONFIGS: list[dict[str, Any]] = [
    {},
    {"experts": KNNExperts(k=3), "choice": Proportional()},
    {"experts": MLPExperts(), "drive": GlobalProgress(), "meta": MetaPredictor()},
    {"experts": NetworkExperts(), "drive": Error(source="meta"), "meta": MetaPredictor()},
    {"drive": Improvement(), "improvement": ImprovementPredictor(), "choice": Softmax()},
    {"drive": Novelty(), "shadows": {"mlp": MLPExperts()}},
    {"drive": Curriculum()},
    {"experts": HybridExperts(), "shadows": {"hybrid": HybridExperts()}},
]


def born(values: dict[str, Any], device: str) -> tuple[Any, IAC]:
    """Worlds, and robots of which a region is soon full."""
    env = gym.make_vec(KINEMATIC, num_envs=4, device=device, check_actions=False)
    space = SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    config = IACConfig(max_examples=20, delay=5, window=5, **values)
    return env, IAC(space, config, range(4), device)


def live(env: Any, agent: IAC, sensors: Tensor, n_decisions: int) -> None:
    for _ in range(n_decisions):
        sensors, *_ = env.step(agent.act(sensors))
        agent.observe(sensors)


@pytest.mark.parametrize("values", CONFIGS, ids=str)
def test_a_decision_without_a_split_asks_a_gpu_once(
    values: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Before the first decision one may ask.
    monkeypatch.setattr(torch_iac.agent, "available_device", torch.device)
    env, agent = born(values, "meta")
    agent.tree._n_bundle_levels = 3  # as if regions had split
    sensors, _ = env.reset(seed=0)
    asked = []

    def nothing_is_full_or_wrong(of: Tensor) -> list[bool]:
        asked.append(of)
        return [False] * len(of)

    monkeypatch.setattr(Tensor, "tolist", nothing_is_full_or_wrong)
    live(env, agent, sensors, n_decisions=5)
    assert len(asked) == 5


@pytest.mark.parametrize("values", CONFIGS, ids=str)
def test_all_is_made_where_the_robots_are(values: dict[str, Any]) -> None:
    env, agent = born(values, "cpu")
    sensors, _ = env.reset(seed=0)
    with torch.device("meta"):  # where a tensor is made if nobody says where
        live(env, agent, sensors, n_decisions=80)
        agent.region_summary()
        agent.genealogy()
        agent.state()
    assert agent.tree.n_nodes > 4
