"""Vectors of worlds, and the ends of episodes in worlds that reset themselves."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from torch import Tensor

World = gym.vector.VectorEnv[Any, Any, Any]
"""Worlds side by side, one an agent; sensors have shape `(A, sensor_dim)`, in raw units."""


def outcome_of(
    env: gym.vector.VectorEnv[Any, Any, Any],
    sensors: Any,
    is_over: NDArray[np.bool_] | Tensor,
    info: dict[str, Any],
) -> Any:
    """Return the sensors after an action, also in worlds that have reset themselves since.

    Args:
        env: The worlds.
        sensors: Shape `(A, sensor_dim)`, what they showed last.
        is_over: Shape `(A,)`, whether an episode ended with the action.
        info: What `step` returned.

    Raises:
        ValueError: An episode ended in worlds that do not show its end; those made with
            `AutoresetMode.SAME_STEP` do, and those that do not reset themselves.
    """
    mode = env.metadata.get("autoreset_mode")
    if mode == AutoresetMode.DISABLED or not is_over.any():
        return sensors
    if mode != AutoresetMode.SAME_STEP:
        raise ValueError(
            f"a world whose episodes end must be made with autoreset_mode SAME_STEP, got {mode}"
        )
    outcome = sensors.copy()
    for world in np.flatnonzero(is_over):
        outcome[world] = info["final_obs"][world]
    return outcome
