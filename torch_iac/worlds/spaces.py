"""Spaces of any kind as rows of numbers, and worlds whose spaces are made flat boxes."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from torch_iac.worlds.encoders import CONVOLUTION, PIXELS, Encoder, check_encoder

Numbers: TypeAlias = NDArray[Any]
"""A row of numbers, shape `(n,)`, in raw units."""

Kind: TypeAlias = Literal["action", "sensor"]
"""What the numbers of a row are."""

MakeEncoder: TypeAlias = Callable[[tuple[int, ...]], Encoder]
"""Makes the encoder of pictures of a shape."""

LEFT_OUT = "texts_left_out"
"""Key in a flat world's `metadata` of the texts that the robot does not sense."""

SPACES = {"action": "the action space", "sensor": "the observation space"}
"""Spaces in words."""


@dataclass(frozen=True)
class Row:
    """A space as a row of numbers.

    Attributes:
        names: The name of each number.
        low: The least values.
        high: The greatest values.
        n_values: How many values each has, if it is an action and they are counted.
        texts: The names of texts, which are left out.
        of_value: Returns a value of the space as a row.
        to_value: Returns a row, rounded to values that there are, as a value of the space.
    """

    names: tuple[str, ...]
    low: Numbers
    high: Numbers
    n_values: tuple[int | None, ...]
    texts: tuple[str, ...]
    of_value: Callable[[Any], Numbers]
    to_value: Callable[[Numbers], Any]


class Flat:
    """Flat boxes that stand for the spaces of a world.

    The actions of `Discrete`, `MultiDiscrete`, `MultiBinary` and of boxes of whole numbers have the
    values that they have there, as `action_values` says. A `Discrete` observation of other than two
    values is a sensor for each value, 1 where it is the value; pictures (boxes of uint8 with two or
    three dimensions) are the features that an encoder makes of them, without bounds; all else are
    numbers as they are. Texts in a `Dict` or a `Tuple` are left out.

    Names are paths: `goal/0` is the first number of what is called goal in a `Dict`,
    `image/feature_0` a feature, `sensor_3_1` a number in a box of two dimensions. The world's own
    names, in its `metadata`, come before these.

    Args:
        action_space: A world's, of single actions.
        observation_space: A world's, of single observations.
        metadata: The world's.
        encoder: Makes the encoder of pictures of a shape; None if each pixel is a sensor.

    Attributes:
        actions: The action space as a row.
        sensors: The observation space as a row.
        action_space: A flat box.
        observation_space: A flat box.
        metadata: The world's, with `action_names`, `action_values`, `sensor_names` and the texts
            that are left out.

    Raises:
        ValueError: A space holds what is no number.
    """

    def __init__(
        self,
        action_space: spaces.Space[Any],
        observation_space: spaces.Space[Any],
        metadata: Mapping[str, Any],
        encoder: MakeEncoder | None,
    ) -> None:
        self.actions = actions = _row(action_space, "action", (), None)
        self.sensors = sensors = _row(observation_space, "sensor", (), encoder)
        if sensors.texts and not sensors.names:
            raise ValueError(_refusal("sensor", (), observation_space))
        self.action_space = _box(actions, np.float32 if None in actions.n_values else np.int64)
        self.observation_space = _box(sensors, np.float64)
        said = {
            "action_names": actions.names,
            "action_values": actions.n_values,
            "sensor_names": sensors.names,
            LEFT_OUT: sensors.texts,
        }
        self.metadata = {**metadata, **{key: metadata.get(key) or of for key, of in said.items()}}


class FlatWorld(gym.Wrapper[Numbers, Numbers, Any, Any], gym.utils.RecordConstructorArgs):
    """A wrapper of a world of any spaces, whose own are flat boxes; `Flat` says which.

    Args:
        env: The world.
        encoder: What makes sensors of pictures: `convolution`, `pixels` or `module:Name`.

    Raises:
        ValueError: A space holds what is no number, or the encoder is refused.

    Example:
        >>> env = FlatWorld(gym.make("CartPole-v1"))
        >>> env.action_space
        Box(0, 1, (1,), int64)
    """

    def __init__(
        self, env: gym.Env[Any, Any], encoder: str | MakeEncoder | None = CONVOLUTION
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, encoder=encoder)
        gym.Wrapper.__init__(self, env)
        make_encoder = encoder_maker(encoder) if isinstance(encoder, str) else encoder
        self._flat = flat = Flat(
            env.action_space, env.observation_space, env.metadata, make_encoder
        )
        self.action_space, self.observation_space = flat.action_space, flat.observation_space
        self.metadata = flat.metadata

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._flat.sensors.of_value(observation), info

    def step(self, action: Numbers) -> tuple[Numbers, Any, bool, bool, dict[str, Any]]:
        """Take an action."""
        value = self._flat.actions.to_value(action)
        observation, reward, terminated, truncated, info = self.env.step(value)
        return self._flat.sensors.of_value(observation), reward, terminated, truncated, info


def _box(row: Row, dtype: type[Any]) -> spaces.Box[Any]:
    return spaces.Box(row.low.astype(dtype), row.high.astype(dtype), dtype=dtype)


def encoder_maker(name: str) -> MakeEncoder | None:
    """Return what makes encoders, one for all pictures of a shape; None if pixels are sensors.

    Raises:
        ValueError: The name is none of an encoder.
    """
    check_encoder(name)
    return None if name == PIXELS else cache(partial(Encoder, name))


def flattened(env: gym.Env[Any, Any], encoder: MakeEncoder | None) -> gym.Env[Any, Any]:
    """Return a world itself if its spaces are flat boxes, actions of real numbers, or wrap it."""
    return env if is_flat(env.action_space, env.observation_space) else FlatWorld(env, encoder)


def is_flat(action_space: spaces.Space[Any], observation_space: spaces.Space[Any]) -> bool:
    """Return whether both are flat boxes, that of the actions one of real numbers."""
    both = (action_space, observation_space)
    boxes = all(isinstance(of, spaces.Box) and len(of.shape) == 1 for of in both)
    return boxes and np.issubdtype(action_space.dtype, np.floating)


def _row(
    space: spaces.Space[Any], kind: Kind, path: tuple[str, ...], encoder: MakeEncoder | None
) -> Row:
    """Return a space, or the part of it at a path, as a row."""
    match space:
        case spaces.Dict():
            parts = {key: _row(of, kind, (*path, key), encoder) for key, of in space.items()}
            return _joined(parts, dict)
        case spaces.Tuple():
            places = {i: _row(of, kind, (*path, str(i)), encoder) for i, of in enumerate(space)}
            return _joined(places, lambda values: tuple(values.values()))
        case spaces.Box() if encoder and kind == "sensor" and is_picture(space):
            return _picture_row(space, path, encoder)
        case spaces.Discrete() if kind == "sensor" and space.n != 2:
            return _one_hot_row(space, path)
        case spaces.Box() | spaces.MultiBinary() | spaces.MultiDiscrete() | spaces.Discrete():
            return _number_row(space, kind, path)
        case _ if kind == "sensor" and path and space.dtype is not None and space.dtype.kind == "U":
            return Row((), np.empty(0), np.empty(0), (), ("/".join(path),), _nothing, _nothing)
    raise ValueError(_refusal(kind, path, space))


def is_picture(space: spaces.Space[Any]) -> bool:
    """Return whether a space is of pictures: a box of uint8 with two or three dimensions."""
    return isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(space.shape) in (2, 3)


def _joined(parts: Mapping[Any, Row], gathered: Callable[[dict[Any, Any]], Any]) -> Row:
    """Return the row of a space that has parts, which lie beside each other.

    Args:
        parts: The rows by the keys of the values.
        gathered: Makes a value of the values of the parts by their keys.
    """
    rows = parts.values()
    ends = np.cumsum([len(row.names) for row in rows])[:-1]

    def of_value(value: Any) -> Numbers:
        return np.concatenate([row.of_value(value[key]) for key, row in parts.items()])

    def to_value(numbers: Numbers) -> Any:
        pieces = zip(parts.items(), np.split(numbers, ends), strict=True)
        return gathered({key: row.to_value(piece) for (key, row), piece in pieces})

    return Row(
        tuple(name for row in rows for name in row.names),
        np.concatenate([np.empty(0), *(row.low for row in rows)]),
        np.concatenate([np.empty(0), *(row.high for row in rows)]),
        tuple(n for row in rows for n in row.n_values),
        tuple(text for row in rows for text in row.texts),
        of_value,
        to_value,
    )


def _number_row(space: spaces.Space[Any], kind: Kind, path: tuple[str, ...]) -> Row:
    """Return the row of a space of numbers, as they are."""
    low, high = _bounds(space)
    is_whole = not np.issubdtype(space.dtype, np.floating)
    counts = high.ravel() - low.ravel() + 1 if is_whole and kind == "action" else None

    def to_value(numbers: Numbers) -> Any:
        nearest = np.rint(numbers) if is_whole else numbers
        within = np.clip(nearest.reshape(low.shape), low, high)  # float32 may round a bound up
        value = np.asarray(within, space.dtype)
        return value[()] if isinstance(space, spaces.Discrete) else value

    return Row(
        tuple(_names(kind, path, low.shape)),
        low.ravel(),
        high.ravel(),
        (None,) * low.size if counts is None else tuple(map(int, counts)),
        (),
        lambda value: np.asarray(value, float).ravel(),
        to_value,
    )


def _bounds(space: spaces.Space[Any]) -> tuple[Numbers, Numbers]:
    """Return the least and the greatest values of a space of numbers, in its shape."""
    match space:
        case spaces.Box():
            low, high = space.low, space.high
        case spaces.MultiBinary():
            low, high = np.zeros(space.shape), np.ones(space.shape)
        case spaces.MultiDiscrete():
            low, high = space.start, space.start + space.nvec - 1
        case spaces.Discrete():
            low, high = np.asarray(space.start), np.asarray(space.start + space.n - 1)
    return low.astype(float), high.astype(float)


def _one_hot_row(space: spaces.Discrete, path: tuple[str, ...]) -> Row:
    """Return the row of a discrete observation: for each value, whether it is the one."""
    n_values = int(space.n)
    values = np.arange(n_values) + space.start
    return Row(
        tuple(_names("sensor", path, (n_values,))),
        np.zeros(n_values),
        np.ones(n_values),
        (None,) * n_values,
        (),
        lambda value: (values == value).astype(float),
        _nothing,
    )


def _picture_row(space: spaces.Box[Any], path: tuple[str, ...], encoder: MakeEncoder) -> Row:
    """Return the row of a picture's features."""
    encode = encoder(space.shape)
    unbounded = np.full(encode.n_features, np.inf)
    names = ("/".join((*path, f"feature_{i}")) for i in range(encode.n_features))
    counts = (None,) * encode.n_features
    return Row(tuple(names), -unbounded, unbounded, counts, (), encode, _nothing)


def _nothing(_: Any) -> Numbers:
    return np.empty(0)


def _names(kind: Kind, path: tuple[str, ...], shape: tuple[int, ...]) -> Iterator[str]:
    """Return the name of each number of a part: its path and its place in the part."""
    for place in np.ndindex(shape):
        where = "_".join(map(str, place))
        if path:
            yield "/".join((*path, where) if where else path)
        else:
            yield f"{kind}_{where or 0}"


def _refusal(kind: Kind, path: tuple[str, ...], space: spaces.Space[Any]) -> str:
    where = f" for {'/'.join(path)}" if path else ""
    return (
        f"{SPACES[kind]} must be of numbers (Box, Discrete, MultiBinary, MultiDiscrete, or a Dict "
        f"or Tuple of them), got {type(space).__name__}{where}"
    )
