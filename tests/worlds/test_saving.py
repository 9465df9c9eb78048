"""Worlds that cannot be saved go on all the same."""

from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from torch_iac.internal.serialize import pack, unpack
from torch_iac.worlds.saving import Replayed

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
