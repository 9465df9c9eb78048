"""Saves worlds: by their own state, or by their seeds and all actions since."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray

from torch_iac.worlds.vector import World

STATE = "full_state"
"""The attribute of a single world that holds its exact state; it can be read and set."""

ELAPSED = "_elapsed_steps"
"""The attribute in which Gymnasium's `TimeLimit` counts the steps of an episode."""


class Replayed(VectorWrapper):
    """A vector of worlds whose state is its seeds and all actions since.

    To go on from a state, all actions are repeated, which takes as long as the first time. The
    world must be deterministic: its random numbers must all come from the seed of its `reset`.

    Args:
        env: The worlds; they take float32 actions, and sensors are arrays.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env)
        self._shape = env.action_space.shape or ()
        self._seeds: list[int] = []
        self._actions = bytearray()  # grows by doubling, without a Python object a decision
        self._sensors: NDArray[Any] = np.empty(0)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start the worlds, from a list of seeds, one a world, if they are to be saved."""
        self._sensors, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._seeds = [each for each in seed if each is not None] if isinstance(seed, list) else []
        self._actions.clear()
        return self._sensors, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take an action in each world, and store it."""
        self._actions += np.asarray(actions, np.float32).tobytes()
        self._sensors, rewards, terminated, truncated, info = self.env.step(actions)
        return self._sensors, rewards, terminated, truncated, info

    def get_state(self) -> dict[str, Any]:
        """Return `seeds`, a list; `actions`, all since; `sensors`, what they read now.

        Actions have shape `(n, A, action_dim)`, sensors `(A, sensor_dim)`, in raw units.

        Raises:
            ValueError: The worlds were not started from a list of seeds.
        """
        if len(self._seeds) != self.num_envs:
            raise ValueError(
                f"reset needs a list of {self.num_envs} seeds for its worlds to be saved, "
                f"got {self._seeds or None}"
            )
        actions = np.frombuffer(bytes(self._actions), np.float32)
        return {
            "seeds": list(self._seeds),
            "actions": actions.reshape(-1, *self._shape),
            "sensors": np.array(self._sensors),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Start from the seeds and take all actions again.

        Raises:
            ValueError: It does not end where it did.
        """
        self.reset(seed=list(state["seeds"]))
        for actions in state["actions"]:
            self.step(actions)
        if not np.array_equal(self._sensors, state["sensors"]):
            raise ValueError(
                f"a world must repeat itself to be gone on with, but after the same seeds and "
                f"{len(state['actions'])} actions {self.env} reads other sensors"
            )


def world_state(env: World) -> Any:
    """Return the state of some worlds.

    Raises:
        AttributeError: They have neither `get_state` nor `STATE`.
    """
    whole = getattr(_saved_as_one(env), "get_state", None)
    if whole:
        return whole()
    states = list(env.get_attr(STATE))  # type: ignore[attr-defined]
    if not _has_time_limits(env):
        return states
    return {"worlds": states, "elapsed": list(env.get_attr(ELAPSED))}  # type: ignore[attr-defined]


def set_world_state(env: World, state: Any) -> None:
    """Let worlds go on from what `world_state` returned, exactly."""
    whole = getattr(_saved_as_one(env), "set_state", None)
    if whole:
        whole(state)
        return
    if isinstance(state, dict):
        env.set_attr(ELAPSED, state["elapsed"])  # type: ignore[attr-defined]
        state = state["worlds"]
    env.set_attr(STATE, state)  # type: ignore[attr-defined]


def _has_time_limits(env: World) -> bool:
    """Return whether episodes end after so many steps, which a wrapper counts, not the world."""
    worlds = getattr(env.unwrapped, "envs", None)
    if worlds is not None:
        return any(world.has_wrapper_attr(ELAPSED) for world in worlds)
    specs = env.get_attr("spec")  # type: ignore[attr-defined]  # in other processes
    return any(spec is not None and spec.max_episode_steps is not None for spec in specs)


def _saved_as_one(env: World) -> World:
    while isinstance(env, VectorWrapper) and not hasattr(env, "get_state"):
        env = env.env
    return env


def savable(env: World) -> World:
    """Return the worlds themselves if they can be saved, else wrapped in `Replayed`."""
    worlds = getattr(env, "envs", ())
    know_how = all(hasattr(type(world.unwrapped), STATE) for world in worlds)
    return env if know_how else Replayed(env)
