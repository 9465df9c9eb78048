"""The sensorimotor space: what a robot can do, sense and predict, and in which bounds.

Shapes, here and in every module: `A` agents, `C` candidates, `D` situation dimensions,
`K` outcome dimensions, `N` examples that a region can hold.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, Self

import gymnasium as gym
import numpy as np

MOST_BOUND, LEAST_SPAN, LEAST_SHARE = 1e30, 1e-30, 2.0**-20
"""The largest bound, and how narrow a range may be, in raw units and as a share of its larger
bound: beyond, float32 overflows, or tells only a few values in the range apart."""

MOST_VALUES = 2**20
"""Limit of the values of a dimension that has but some."""


class HasSpaces(Protocol):
    """What has an action space and an observation space: a world, or a vector of worlds.

    Attributes:
        metadata: What it says of itself, such as the names of its actions.
    """

    metadata: dict[str, Any]


@dataclass(frozen=True)
class Dimension:
    """One number of the action or of the sensors: its name and its bounds.

    Attributes:
        name: Its name.
        low: Its least value, in raw units.
        high: Its greatest value, in raw units.
        n_values: How many values it has, evenly spaced from low to high; None if any number between
            them is one.

    Raises:
        ValueError: The bounds are no numbers, not finite, not in order, or too large or too close
            for float32, or the number of values is below 2 or above `MOST_VALUES`.
    """

    name: str
    low: float
    high: float
    n_values: int | None = None

    def __post_init__(self) -> None:
        for bound in ("low", "high"):
            object.__setattr__(self, bound, _bound(self.name, getattr(self, bound)))
        object.__setattr__(self, "n_values", _plain(self.n_values))
        bounds = f"[{self.low}, {self.high}]"
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"the bounds of {self.name} must be finite and in order, got {bounds}")
        largest, apart = max(abs(self.low), abs(self.high)), self.high - self.low
        if self.n_values is not None:
            if type(self.n_values) is not int or not 2 <= self.n_values <= MOST_VALUES:
                raise ValueError(
                    f"the values of {self.name} must number from 2 to {MOST_VALUES:,}, "
                    f"got {self.n_values}"
                )
            apart /= self.n_values - 1
        if largest > MOST_BOUND or apart < max(LEAST_SPAN, largest * LEAST_SHARE):
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
        env: HasSpaces,
        outcomes: Sequence[str] | Literal["all"] = "all",
    ) -> Self:
        """Return the space of a Gymnasium world whose actions and observations are boxes.

        Names come from the world's `metadata["action_names"]` and `metadata["sensor_names"]`;
        without them they are `action_0`, `action_1`, ... and `sensor_0`, ... Its
        `metadata["action_values"]` may say how many values each action has, evenly spaced between
        its bounds; None for any number. `torch_iac.worlds.spaces.FlatWorld` makes boxes of other
        spaces.

        Args:
            env: A world, or a vector of worlds.
            outcomes: The names of the sensors to predict, or "all".

        Raises:
            ValueError: A space is not a bounded, flat box, that of the actions is of whole
                numbers without `action_values`, or an outcome is no sensor.
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

        They are under `actions`, `sensors` and `outcomes`. Of a dimension that has but some values
        their number follows, `[low, high, n_values]`.
        """
        return {
            kind: {of.name: _numbers(of) for of in getattr(self, kind)}
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
                tuple(_dimension(name, numbers) for name, numbers in bounds[kind].items())
                for kind in ("actions", "sensors", "outcomes")
            )
        )


def _plain(number: Any) -> Any:
    """Return a number as Python's own; numpy's are taken for what they are."""
    return number.item() if np.ndim(number) == 0 and hasattr(number, "item") else number


def _bound(name: str, bound: Any) -> float:
    """Return a bound as Python's own number."""
    number = _plain(bound)
    if type(number) not in (int, float):
        raise ValueError(f"the bounds of {name} must be numbers, got {bound!r:.80}")
    return float(number) if abs(number) <= sys.float_info.max else math.copysign(math.inf, number)


def _numbers(dimension: Dimension) -> list[float]:
    bounds = [dimension.low, dimension.high]
    return bounds if dimension.n_values is None else [*bounds, dimension.n_values]


def _dimension(name: str, numbers: Sequence[float]) -> Dimension:
    if len(numbers) not in (2, 3):
        raise ValueError(
            f"{name} must have a low and a high bound, perhaps a number of values, got {numbers}"
        )
    low, high, *n_values = numbers
    return Dimension(name, low, high, int(n_values[0]) if n_values else None)


def _dimensions(env: HasSpaces, kind: Literal["action", "observation"]) -> tuple[Dimension, ...]:
    box = space_of(env, kind)
    if not isinstance(box, gym.spaces.Box) or len(box.shape) != 1:
        raise ValueError(
            f"the {kind} space must be a flat Box, got {box}; FlatWorld makes others one"
        )
    counts = env.metadata.get("action_values") if kind == "action" else None
    if kind == "action" and counts is None and not np.issubdtype(box.dtype, np.floating):
        raise ValueError(f"the action space must be of real numbers, got {box}")
    names = names_of(env, "action" if kind == "action" else "sensor")
    counts = (None,) * len(names) if counts is None else tuple(counts)
    if len(counts) != len(names):
        raise ValueError(f"action_values must number {len(names)} dimensions, got {counts}")
    if not np.isfinite(box.low).all() or not np.isfinite(box.high).all():
        raise ValueError(f"the {kind} space must have finite bounds, got {box}")
    columns = zip(names, box.low.tolist(), box.high.tolist(), counts, strict=True)
    return tuple(Dimension(*column) for column in columns)


def names_of(env: HasSpaces, kind: Literal["action", "sensor"]) -> tuple[str, ...]:
    """Return the names of a world's actions or sensors, which are flat boxes.

    Raises:
        ValueError: The world names more or fewer than there are.
    """
    n_names = space_of(env, "action" if kind == "action" else "observation").shape[0]
    key = f"{kind}_names"
    names = tuple(env.metadata.get(key) or (f"{kind}_{i}" for i in range(n_names)))
    if len(names) != n_names:
        raise ValueError(f"{key} must name {n_names} dimensions, got {names}")
    return names


def space_of(env: HasSpaces, kind: Literal["action", "observation"]) -> Any:
    """Return a world's space, or that of each world of a vector."""
    return getattr(env, f"single_{kind}_space", None) or getattr(env, f"{kind}_space")


def _no_such_sensor(name: str, sensors: Sequence[Dimension]) -> str:
    return f"outcomes must be sensors ({', '.join(d.name for d in sensors)}), got {name}"
