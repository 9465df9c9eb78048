"""Bounds of sensors that a world leaves open: given by the user, or found by random decisions."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from torch_iac.space import MOST_BOUND, Dimension, HasSpaces, names_of, space_of
from torch_iac.worlds.vector import World, outcome_of

MARGIN = 0.1
"""Margin around the readings, as a share of their range, for bounds that are found."""

STILL = 1e-6
"""A sensor whose range is a smaller share of its size, or of 1, counts as constant."""

BOUNDS_FROM = 1000
"""How many random decisions find bounds of sensors that have none."""

SEED = 0
"""Seed of the random decisions by which bounds are found, whatever the robots' seeds."""

Floats = NDArray[np.floating[Any]]
"""A number for each sensor, shape `(sensor_dim,)`, in raw units."""


@dataclass(frozen=True)
class Bounds:
    """Bounds for all sensors of a world, not all of them its own.

    Attributes:
        box: What sensors are clipped to, in raw units.
        given: The names of the sensors whose bounds were given.
        found: The names of those for which one was found.
    """

    box: Box
    given: tuple[str, ...]
    found: tuple[str, ...]

    def clip(self, world: World) -> World:
        """Return the worlds with sensors clipped to the bounds.

        Raises:
            ValueError: They are natively vectorised.
        """
        if not hasattr(world.unwrapped, "envs"):
            raise ValueError(
                "sensor_bounds must be left to worlds that are single, "
                f"got {type(world.unwrapped).__name__}"
            )
        return ClippedSensors(world, self.box)


class ClippedSensors(VectorWrapper):
    """A wrapper that clips sensors to bounds.

    Args:
        env: The worlds.
        box: The bounds of one world's sensors, in raw units.
    """

    def __init__(self, env: World, box: Box) -> None:
        super().__init__(env)
        self._low, self._high = box.low, box.high
        self.single_observation_space = box
        self.observation_space = batch_space(box, env.num_envs)

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start the worlds."""
        sensors, info = self.env.reset(**arguments)
        return self._clipped(sensors), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take an action in each world; the last sensors of an episode are clipped too."""
        sensors, rewards, terminated, truncated, info = self.env.step(actions)
        if "final_obs" in info:
            last = [None if of is None else self._clipped(of) for of in info["final_obs"]]
            info["final_obs"] = np.array([*last, None], dtype=object)[:-1]
        return self._clipped(sensors), rewards, terminated, truncated, info

    def _clipped(self, sensors: Any) -> Any:
        return np.clip(sensors, self._low, self._high)


def parse_bounds(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the bounds of sensors, in raw units, each written as name=low,high.

    Raises:
        ValueError: One is written otherwise, or is not finite and in order.
    """
    bounds = {}
    for text in texts:
        name, _, numbers = text.rpartition("=")
        try:
            low, high = map(float, numbers.split(","))
        except ValueError:
            raise ValueError(f"sensor bounds must be written name=low,high, got {text}") from None
        Dimension(name, low, high)  # refuses invalid bounds
        bounds[name] = (low, high)
    return bounds


def bounds_of(
    world: HasSpaces,
    given: Mapping[str, tuple[float, float]],
    n_decisions: int,
    make_single: Callable[[], World],
) -> Bounds | None:
    """Return bounds for all sensors of a world; None if its own will do.

    They are those given; else the world's own; else those found by random decisions.

    Args:
        world: The worlds, which are left as they are.
        given: Low and high, in raw units, by the name of the sensor.
        n_decisions: How many random decisions.
        make_single: Makes a world for them, if they are needed.

    Raises:
        ValueError: A name is no sensor's, or the world names more or fewer than there are.
    """
    box = space_of(world, "observation")
    if not isinstance(box, Box) or len(box.shape) != 1:
        return None  # refused when the space is made
    low, high, names = box.low.astype(float), box.high.astype(float), names_of(world, "sensor")
    for name, of_name in given.items():
        if name not in names:
            raise ValueError(f"sensor bounds must be of {', '.join(names)}, got {name}")
        low[names.index(name)], high[names.index(name)] = of_name
    has_low, has_high = low >= -MOST_BOUND, high <= MOST_BOUND
    found = [name for name, *has in zip(names, has_low, has_high, strict=True) if not all(has)]
    if found:
        with closing(make_single()) as single:
            found_low, found_high = found_bounds(single, n_decisions)
        low, high = np.where(has_low, low, found_low), np.where(has_high, high, found_high)
    if not (given or found):
        return None
    return Bounds(Box(low, high, dtype=np.float64), tuple(given), tuple(found))


def recorded_bounds(config: Mapping[str, Any]) -> Bounds | None:
    """Return the bounds of a run from its `config.json`; None if they are its world's own.

    Raises:
        ValueError: The file lacks a part of them.
    """
    if "bounds" not in config:
        return None
    for kind in ("given", "found"):
        if kind not in config["bounds"]:
            raise ValueError(f"bounds in config.json must have {kind}, got none")
    low, high = zip(*config["space"]["sensors"].values(), strict=True)
    box = Box(np.array(low), np.array(high), dtype=np.float64)
    return Bounds(box, tuple(config["bounds"]["given"]), tuple(config["bounds"]["found"]))


def found_bounds(world: World, n_decisions: int) -> tuple[Floats, Floats]:
    """Return bounds around all that the sensors of a single world read in random decisions.

    They lie a tenth of the range outside of what was read; around a sensor that never moved, by
    1 or its size, whichever is more.

    Returns:
        The low and the high ones, each of shape `(sensor_dim,)`, in raw units.
    """
    world.action_space.seed(SEED)
    sensors, _ = world.reset(seed=SEED)
    low = high = np.asarray(sensors[0], float)
    for _ in range(n_decisions):
        sensors, _, terminated, truncated, info = world.step(world.action_space.sample())
        for reading in (outcome_of(world, sensors, terminated | truncated, info), sensors):
            low, high = np.minimum(low, reading[0]), np.maximum(high, reading[0])
    size = np.maximum(1.0, np.maximum(abs(low), abs(high)))
    margin = np.where(high - low < STILL * size, size, MARGIN * (high - low))
    return low - margin, high + margin
