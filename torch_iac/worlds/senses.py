"""What those see of a world of any spaces who look on while others act in it.

Shapes: `A` worlds.
"""

from collections.abc import Mapping
from typing import Any, Self, TypeAlias

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray
from torch import Tensor

from torch_iac.space import names_of, space_of
from torch_iac.worlds.bounds import BOUNDS_FROM, bounds_of
from torch_iac.worlds.encoders import CONVOLUTION
from torch_iac.worlds.spaces import Flat, Row, encoder_maker, flattened, is_flat
from torch_iac.worlds.vector import World

Rows: TypeAlias = NDArray[Any] | Tensor
"""A row of numbers for each world, in raw units."""


class Senses:
    """The actions and the observations of some worlds as rows of numbers, sensors in bounds.

    Args:
        env: A world, or a vector of worlds; it is left as it is.
        encoder: What makes sensors of pictures: `convolution`, `pixels` or `module:Name`.
        sensor_bounds: Low and high of sensors, in raw units, by name; readings beyond are clipped.
        bounds_from: How many random decisions, in a copy of the world, find those of others that
            have none.

    Attributes:
        action_space: A flat box.
        observation_space: A flat box.
        metadata: The world's, with the names of both.

    Raises:
        ValueError: A space holds what is no number, the encoder or a bound is refused, or bounds
            must be found and the world cannot be made once more.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any] | World,
        encoder: str = CONVOLUTION,
        sensor_bounds: Mapping[str, tuple[float, float]] | None = None,
        bounds_from: int = BOUNDS_FROM,
    ) -> None:
        make_encoder, self._encoder = encoder_maker(encoder), encoder
        spaces = space_of(env, "action"), space_of(env, "observation")
        flat = None if is_flat(*spaces) else Flat(*spaces, env.metadata, make_encoder)
        self._env, self._flat = env, flat
        self._is_vector = isinstance(env, gym.vector.VectorEnv)
        self.action_space, self.observation_space = spaces
        self.metadata = env.metadata
        if flat is not None:
            self.action_space, self.observation_space = flat.action_space, flat.observation_space
            self.metadata = flat.metadata
        bounds = bounds_of(
            self,
            sensor_bounds or {},
            bounds_from,
            lambda: SyncVectorEnv(
                [lambda: flattened(_another(env), make_encoder)],
                autoreset_mode=AutoresetMode.SAME_STEP,
            ),
        )
        self._bounds: tuple[NDArray[Any], NDArray[Any]] | None = None
        self._not_the_worlds: dict[str, tuple[float, float]] = {}
        if bounds is not None:
            self.observation_space = bounds.box
            self._bounds = low, high = bounds.box.low, bounds.box.high
            names = names_of(self, "sensor")
            places = [names.index(name) for name in (*bounds.given, *bounds.found)]
            self._not_the_worlds = {names[at]: (float(low[at]), float(high[at])) for at in places}

    def of_another(self, env: gym.Env[Any, Any] | World) -> Self:
        """Return what is seen of another world, with the same encoder, in the same bounds.

        Raises:
            ValueError: It does not have the same sensors, or is refused.
        """
        return type(self)(env, self._encoder, self._not_the_worlds)

    def actions(self, actions: Any) -> Rows:
        """Return what is done, in the one world or in all, as rows `(A, action_dim)`."""
        return self._rows(actions, "action", self._flat.actions if self._flat else None)

    def sensors(self, observations: Any) -> Rows:
        """Return what the one world or all show, as rows `(A, sensor_dim)`, in bounds."""
        return self._clipped(
            self._rows(observations, "observation", self._flat.sensors if self._flat else None)
        )

    def info(self, info: dict[str, Any]) -> dict[str, Any]:
        """Return what `step` of worlds tells, the last observations of episodes as rows, alike."""
        if "final_obs" not in info or (self._flat is None and self._bounds is None):
            return info
        of_value = self._flat.sensors.of_value if self._flat else np.asarray
        rows = np.full(len(info["final_obs"]), None, dtype=object)
        for world, last in enumerate(info["final_obs"]):
            rows[world] = None if last is None else self._clipped(of_value(last))
        return {**info, "final_obs": rows}

    def _rows(self, values: Any, kind: str, row: Row | None) -> Rows:
        if not self._is_vector:
            if row is None and isinstance(values, Tensor):
                return values[None]
            return np.asarray(row.of_value(values) if row else values)[None]
        if row is None:
            return values if isinstance(values, Tensor) else np.asarray(values)
        each = iterate(getattr(self._env, f"{kind}_space"), values)
        return np.stack([row.of_value(value) for value in each])

    def _clipped(self, sensors: Rows) -> Rows:
        if self._bounds is None:
            return sensors
        if isinstance(sensors, Tensor):
            low, high = (torch.as_tensor(of, device=sensors.device) for of in self._bounds)
            return sensors.clamp(low, high)
        return np.clip(sensors, *self._bounds)


def _another(env: gym.Env[Any, Any] | World) -> gym.Env[Any, Any]:
    """Make a world like this one, or like each of these, once more.

    Raises:
        ValueError: Nobody knows how.
    """
    makers = getattr(env.unwrapped, "env_fns", None)
    if makers:
        made: gym.Env[Any, Any] = makers[0]()
        return made
    if isinstance(env, gym.vector.VectorEnv) or env.spec is None:
        raise ValueError(
            "sensor_bounds must be given for all sensors without bounds of a world that "
            f"gymnasium.make did not make, got {env}"
        )
    return gym.make(env.spec)
