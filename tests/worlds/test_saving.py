"""Worlds that cannot be saved go on all the same."""

from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from torch_iac.internal.serialize import pack, unpack
from torch_iac.worlds.make import make_world
from torch_iac.worlds.saving import Replayed, set_world_state, world_state
from torch_iac.worlds.vector import World

SEEDS: list[int | None] = [3, 4]
MUJOCO = pytest.param(
    "Reacher-v5",
    marks=pytest.mark.skipif(not find_spec("mujoco"), reason="needs the extra mujoco"),
)


def worlds(name: str = "Pendulum-v1", **options: Any) -> Replayed:
    """Return two worlds, whose episodes last ten decisions."""
    mode = {"autoreset_mode": AutoresetMode.SAME_STEP}
    return Replayed(
        gym.make_vec(name, 2, "sync", vector_kwargs=mode, max_episode_steps=10, **options)
    )


def lived(env: Replayed, n_decisions: int, first: int = 0) -> NDArray[Any]:
    """Return what the sensors read after each of so many decisions."""
    space = env.single_action_space
    assert isinstance(space, gym.spaces.Box)
    readings = []
    for decision in range(first, first + n_decisions):
        share = np.random.default_rng(decision).random((2, *space.shape), np.float32)
        readings.append(env.step(space.low + share * (space.high - space.low))[0].copy())
    return np.array(readings)


@pytest.mark.parametrize("name", ["Pendulum-v1", "MountainCarContinuous-v0", MUJOCO])
def test_a_world_goes_on_from_its_state_over_the_ends_of_episodes(name: str) -> None:
    env = worlds(name)
    env.reset(seed=SEEDS)
    lived(env, 25)
    tensors, content = pack(env.get_state())
    expected = lived(env, 25, first=25)
    again = worlds(name)
    again.set_state(unpack(tensors, content))
    np.testing.assert_array_equal(lived(again, 25, first=25), expected)


def test_a_state_can_be_saved_again_after_going_on() -> None:
    env, again = worlds(), worlds()
    env.reset(seed=SEEDS)
    lived(env, 5)
    again.set_state(env.get_state())
    lived(env, 5, first=5)
    lived(again, 5, first=5)
    np.testing.assert_array_equal(again.get_state()["actions"], env.get_state()["actions"])
    assert env.get_state()["actions"].shape == (10, 2, 1)


def test_starting_anew_forgets_what_was() -> None:
    env = worlds()
    env.reset(seed=SEEDS)
    lived(env, 5)
    env.reset(seed=SEEDS)
    assert len(env.get_state()["actions"]) == 0


def test_a_world_that_does_not_repeat_itself_is_refused() -> None:
    env, other = worlds(), worlds(g=9.0)
    env.reset(seed=SEEDS)
    lived(env, 5)
    with pytest.raises(ValueError, match=r"^a world must repeat itself to be gone on with.* 5 act"):
        other.set_state(env.get_state())


@pytest.mark.parametrize("seed", [None, 3])
def test_without_a_seed_for_each_world_nothing_can_be_saved(seed: int | None) -> None:
    env = worlds()
    env.reset(seed=seed)
    with pytest.raises(ValueError, match="needs a list of 2 seeds"):
        env.get_state()


class Counter(gym.Env[NDArray[Any], NDArray[Any]]):
    """Its sensor counts its steps; it can be saved, but not the wrappers around it."""

    full_state = 0

    def __init__(self) -> None:
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gym.spaces.Box(0.0, 10.0, (1,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.full_state = 0
        return np.zeros(1, np.float32), {}

    def step(self, _: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        self.full_state += 1
        return np.full(1, self.full_state, np.float32), 0.0, False, False, {}


def limited(name: str) -> World:
    """Return two worlds whose episodes last five decisions, made in one of the ways there are."""
    mode: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    if name == "wrapped":
        return SyncVectorEnv([lambda: gym.wrappers.TimeLimit(Counter(), 5)] * 2, **mode)
    maker: Any = Counter
    gym.register("Counter-v0", maker, max_episode_steps=5)
    try:
        if name == "made":
            return make_world("Counter-v0", 2, {}, torch.device("cpu"))
        return gym.make_vec("Counter-v0", 2, name, vector_kwargs=mode)
    finally:
        del gym.registry["Counter-v0"]


@pytest.mark.parametrize("name", ["wrapped", "made", "sync", "async"])
def test_an_episode_that_is_cut_short_goes_on_from_where_it_was(name: str) -> None:
    env, again = limited(name), limited(name)
    actions = np.zeros((2, 1), np.float32)
    for each in (env, again):
        each.reset(seed=SEEDS)  # type: ignore[arg-type]  # a list is fine
    for _ in range(3):
        env.step(actions)
    tensors, content = pack(world_state(env))
    set_world_state(again, unpack(tensors, content))
    readings = [[each.step(actions)[0][1].item() for _ in range(6)] for each in (env, again)]
    assert readings == [[4.0, 0.0, 1.0, 2.0, 3.0, 4.0]] * 2
    for each in (env, again):
        each.close()
