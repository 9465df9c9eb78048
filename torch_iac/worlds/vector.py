"""Vectors of worlds, and the ends of episodes in worlds that reset themselves."""

from collections.abc import Mapping
from contextlib import closing
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from numpy.typing import NDArray
from torch import Tensor

World = gym.vector.VectorEnv[Any, Any, Any]
"""Worlds side by side, one an agent; sensors have shape `(A, sensor_dim)`, in raw units."""

Flags = NDArray[np.bool_] | Tensor
"""A yes or no of each world, shape `(A,)`."""

OVERWRITTEN = (
    "a world whose episodes end must not overwrite what it has shown, but its last sensors are "
    "where those of the next episode are: wrap it in torch_iac.worlds.vector.CopiedSensors"
)
"""What is said of a world that uses one array for all that it shows."""


class CopiedSensors(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """A wrapper whose sensors are a copy.

    A world may use one array for all that it shows. Where it is reset as soon as an episode ends,
    in a vector of mode `SAME_STEP`, it then overwrites the last sensors of the episode.

    Args:
        env: A single world.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)

    def observation(self, observation: Any) -> Any:
        """Return a copy of what the world shows."""
        return deepcopy(observation)


def refuse_overwriting(env: World) -> None:
    """Refuse worlds in other processes that would overwrite the last sensors of an episode.

    From here that cannot be seen when it happens, so one world is made and tried.

    Args:
        env: The worlds.

    Raises:
        ValueError: A world uses one array for all that it shows.
    """
    worlds = env.unwrapped
    if not isinstance(worlds, AsyncVectorEnv) or _mode(env) != AutoresetMode.SAME_STEP:
        return
    with closing(worlds.env_fns[0]()) as world:
        world.reset(seed=0)
        world.action_space.seed(0)
        sensors = world.step(world.action_space.sample())[0]
        if _in_one_place(sensors, world.reset()[0]):
            raise ValueError(OVERWRITTEN)


def outcome_of(env: World, sensors: Any, is_over: Flags, info: Mapping[str, Any]) -> Any:
    """Return the sensors after an action, also in worlds that have reset themselves since.

    Args:
        env: The worlds.
        sensors: Shape `(A, sensor_dim)`, what they showed last.
        is_over: Shape `(A,)`, whether an episode ended with the action.
        info: What `step` returned.

    Raises:
        ValueError: An episode ended in worlds that do not show its end, or have overwritten it;
            those made with `AutoresetMode.SAME_STEP` show it, and those that do not reset
            themselves.
    """
    mode = _mode(env)
    if mode == AutoresetMode.DISABLED or not is_over.any():
        return sensors
    if mode != AutoresetMode.SAME_STEP:
        raise ValueError(
            f"a world whose episodes end must be made with autoreset_mode SAME_STEP, got {mode}"
        )
    ended, last = _numbers(is_over), info.get("final_obs")
    if last is None:
        raise ValueError(
            'info["final_obs"] must hold the last sensors of an episode, got none at its end'
        )
    # A SyncVectorEnv keeps what each world has shown since; others have only the sensors.
    began = getattr(env.unwrapped, "_env_obs", None)
    pairs = [(last, sensors)] if began is None else [(last[i], began[i]) for i in ended]
    if any(_in_one_place(*pair) for pair in pairs):
        raise ValueError(OVERWRITTEN)
    return _replaced(sensors, last, ended)


def zones_of(is_over: Flags, info: Mapping[str, Any]) -> NDArray[Any] | Tensor | None:
    """Return the zone of each world in a step, also in worlds that have reset themselves since.

    Args:
        is_over: Shape `(A,)`, whether an episode ended with the step.
        info: What `step` returned.

    Returns:
        Shape `(A,)`; None if no world tells of a zone.

    Raises:
        ValueError: Some worlds tell of a zone, others do not.
    """
    zones, told = info.get("zone"), info.get("_zone")
    last = info.get("final_info")  # where an episode ended, the rest is of the next one
    if last is not None and len(ended := _numbers(is_over)):
        n_worlds = len(is_over)
        last_zones, last_told = _last_zones(last)
        told = _told(zones, told, n_worlds)
        told[ended] = _told(last_zones, last_told, n_worlds)[ended]
        if last_zones is not None:
            zones = _replaced(last_zones if zones is None else zones, last_zones, ended)
    if zones is None or told is None or told.all():
        return zones
    if not told.any():
        return None
    raise ValueError(
        'info["zone"] must be there at every step of a world with zones, got none of world '
        f"{_numbers(~told)[0]}"
    )


def _mode(env: World) -> Any:
    return env.metadata.get("autoreset_mode")


def _numbers(flags: Flags) -> NDArray[np.intp]:
    """Return the numbers of the worlds for which it is so, such as those whose episode ended."""
    return np.flatnonzero(_array(flags))


def _last_zones(last: Any) -> tuple[Any, Any]:
    """Return zones and who tells of one, each of shape `(A,)` or None, from `final_info`.

    That is one mapping for all worlds, or one for each.
    """
    if isinstance(last, Mapping):
        return last.get("zone"), last.get("_zone")
    zones = [(of or {}).get("zone") for of in last]
    told = np.array([zone is not None for zone in zones])
    return np.array([0 if zone is None else int(zone) for zone in zones]), told


def _told(zones: Any, told: Any, n_worlds: int) -> NDArray[np.bool_]:
    """Return whether each world tells of a zone, shape `(A,)`: without a mask, all or none."""
    if told is None:
        return np.full(n_worlds, zones is not None)
    return np.array(told.tolist(), np.bool_)


def _replaced(values: Any, last: Any, ended: NDArray[np.intp]) -> Any:
    """Return a copy of each world's values with those before its end, where an episode ended.

    Args:
        values: Shape `(A, ...)`, an array or a tensor.
        last: Shape `(A, ...)`, alike, or the values of each world in a list or an array of objects.
        ended: The numbers of the worlds whose episode ended.
    """
    if isinstance(last, Tensor) or (isinstance(last, np.ndarray) and last.dtype != object):
        rows = last[ended]
    elif isinstance(values, Tensor):
        rows = torch.stack([torch.as_tensor(last[world]) for world in ended])
    else:
        rows = np.stack([_array(last[world]) for world in ended])
    if isinstance(values, Tensor):
        values = values.clone()
        values[ended] = torch.as_tensor(rows).to(values)
    else:
        values = np.array(values)
        values[ended] = _array(rows)
    return values


def _array(values: Any) -> NDArray[Any]:
    return values.numpy(force=True) if isinstance(values, Tensor) else np.asarray(values)


def _in_one_place(one: Any, other: Any) -> bool:
    """Return whether what was shown before was overwritten by what was shown afterwards."""
    if isinstance(one, Tensor) and isinstance(other, Tensor):
        return one.data_ptr() == other.data_ptr()
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.shares_memory(one, other)
    return one is other and isinstance(one, list)
