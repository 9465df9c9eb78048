"""The sensorimotor space: what a robot can do, sense and predict, and in which bounds.

Shapes, here and in every module: `A` agents, `C` candidates, `D` situation dimensions,
`K` outcome dimensions, `N` examples that a region can hold.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import gymnasium as gym
import numpy as np

WorldOrWorlds = gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]
"""A single world of Gymnasium, or a vector of them."""

MOST_BOUND, LEAST_SPAN, LEAST_SHARE = 1e30, 1e-30, 2.0**-20
"""The largest bound, and how narrow a range may be, in raw units and as a share of its larger
bound: beyond, float32 overflows, or tells only a few values in the range apart."""


@dataclass(frozen=True)
class Dimension:
    """One number of the action or of the sensors: its name and its bounds.

    Attributes:
        name: Its name.
        low: Its least value, in raw units.
        high: Its greatest value, in raw units.

    Raises:
        ValueError: The bounds are no numbers, not finite, not in order, or too large or too close
            for float32.
    """

    name: str
    low: float
    high: float

    def __post_init__(self) -> None:
        for bound in ("low", "high"):
            object.__setattr__(self, bound, _plain(self.name, getattr(self, bound)))
        bounds = f"[{self.low}, {self.high}]"
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"the bounds of {self.name} must be finite and in order, got {bounds}")
        largest, span = max(abs(self.low), abs(self.high)), self.high - self.low
        if largest > MOST_BOUND or span < max(LEAST_SPAN, largest * LEAST_SHARE):
            raise ValueError(
                f"the bounds of {self.name} must be numbers that float32 holds well apart, "
                f"got {bounds}"
            )


@dataclass(frozen=True)
class SensorimotorSpace:
    """What the robot does (actions), senses (sensors) and predicts (outcomes).

    A *situation* is the action followed by the sensors, scaled to the unit cube. An *outcome* is
    what some of the sensors will read after the action. The papers do not say how dimensions
    compare; here each is scaled by its bounds.

    Attributes:
        actions: The action dimensions, in the order of the world's action vector.
        sensors: The sensor dimensions, in the order of the world's observation vector.
        outcomes: The sensors to be predicted.

    Raises:
        ValueError: No actions, no outcomes, a name given twice or an outcome that is no sensor.
    """

    actions: tuple[Dimension, ...]
    sensors: tuple[Dimension, ...]
    outcomes: tuple[Dimension, ...]

    def __post_init__(self) -> None:
        for kind in ("actions", "outcomes"):
            if not getattr(self, kind):
                raise ValueError(f"{kind} must name at least one dimension, got none")
        for kind in ("actions", "sensors", "outcomes"):
            names = [dimension.name for dimension in getattr(self, kind)]
            if len(set(names)) < len(names):
                raise ValueError(f"{kind} must have different names, got {names}")
        for outcome in self.outcomes:
            if outcome not in self.sensors:
                raise ValueError(_no_such_sensor(outcome.name, self.sensors))

    @classmethod
    def from_env(
        cls,
        env: WorldOrWorlds,
        outcomes: Sequence[str] | Literal["all"] = "all",
    ) -> Self:
        """Return the space of a Gymnasium world whose actions and observations are boxes.

        Names come from the world's `metadata["action_names"]` and `metadata["sensor_names"]`;
        without them they are `action_0`, `action_1`, ... and `sensor_0`, ...

        Args:
            env: A world, or a vector of worlds.
            outcomes: The names of the sensors to predict, or "all".

        Raises:
            ValueError: A space is not a bounded, flat box, actions are whole numbers, or an outcome
                is no sensor.
        """
        actions = _dimensions(env, "action")
        sensors = _dimensions(env, "observation")
        if isinstance(outcomes, str) and outcomes != "all":
            raise ValueError(f"outcomes must be all or a list of sensors, got {outcomes!r}")
        if outcomes == "all":
            return cls(actions, sensors, sensors)
        by_name = {dimension.name: dimension for dimension in sensors}
        unknown = [name for name in outcomes if name not in by_name]
        if unknown:
            raise ValueError(_no_such_sensor(unknown[0], sensors))
        return cls(actions, sensors, tuple(by_name[name] for name in outcomes))

    @property
    def situation(self) -> tuple[Dimension, ...]:
        """The dimensions of a situation: the actions, then the sensors."""
        return self.actions + self.sensors

    @property
    def situation_names(self) -> tuple[str, ...]:
        """The names of the situation's dimensions."""
        return tuple(dimension.name for dimension in self.situation)

    @property
    def outcome_columns(self) -> tuple[int, ...]:
        """The index of each outcome among the sensors."""
        return tuple(self.sensors.index(outcome) for outcome in self.outcomes)

    def to_json(self) -> dict[str, dict[str, list[float]]]:
        """Return each name with its bounds in raw units, `[low, high]`.

        They are under `actions`, `sensors` and `outcomes`.
        """
        return {
            kind: {d.name: [d.low, d.high] for d in getattr(self, kind)}
            for kind in ("actions", "sensors", "outcomes")
        }

    @classmethod
    def from_json(cls, bounds: Mapping[str, Mapping[str, Sequence[float]]]) -> Self:
        """Return the space that `to_json` wrote.

        Raises:
            KeyError: `actions`, `sensors` or `outcomes` is missing.
            ValueError: The bounds, or all of it, make no space.
        """
        return cls(
            *(
                tuple(Dimension(name, low, high) for name, (low, high) in bounds[kind].items())
                for kind in ("actions", "sensors", "outcomes")
            )
        )


def _plain(name: str, bound: Any) -> float:
    """Return a bound as Python's own number; numpy's are taken for what they are."""
    number = bound.item() if np.ndim(bound) == 0 and hasattr(bound, "item") else bound
    if type(number) not in (int, float):
        raise ValueError(f"the bounds of {name} must be numbers, got {bound!r:.80}")
    return float(number) if abs(number) <= sys.float_info.max else math.copysign(math.inf, number)


def _dimensions(env: WorldOrWorlds, kind: str) -> tuple[Dimension, ...]:
    box = _box(env, kind)
    if not isinstance(box, gym.spaces.Box) or len(box.shape) != 1:
        raise ValueError(f"the {kind} space must be a flat Box, got {box}")
    if kind == "action" and not np.issubdtype(box.dtype, np.floating):
        raise ValueError(f"the action space must be of real numbers, got {box}")
    names = names_of(env, "action" if kind == "action" else "sensor")
    if not np.isfinite(box.low).all() or not np.isfinite(box.high).all():
        raise ValueError(f"the {kind} space must have finite bounds, got {box}")
    bounds = zip(names, box.low.tolist(), box.high.tolist(), strict=True)
    return tuple(Dimension(name, low, high) for name, low, high in bounds)


def names_of(env: WorldOrWorlds, kind: Literal["action", "sensor"]) -> tuple[str, ...]:
    """Return the names of a world's actions or sensors, which are flat boxes.

    Raises:
        ValueError: The world names more or fewer than there are.
    """
    n_names = _box(env, "action" if kind == "action" else "observation").shape[0]
    key = f"{kind}_names"
    names = tuple(env.metadata.get(key) or (f"{kind}_{i}" for i in range(n_names)))
    if len(names) != n_names:
        raise ValueError(f"{key} must name {n_names} dimensions, got {names}")
    return names


def _box(env: WorldOrWorlds, kind: str) -> Any:
    return getattr(env, f"single_{kind}_space", None) or getattr(env, f"{kind}_space")


def _no_such_sensor(name: str, sensors: Sequence[Dimension]) -> str:
    return f"outcomes must be sensors ({', '.join(d.name for d in sensors)}), got {name}"
