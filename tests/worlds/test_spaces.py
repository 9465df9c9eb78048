"""Spaces as rows of numbers, and worlds of any spaces made flat."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from torch_iac import IAC, IACConfig, SensorimotorSpace
from torch_iac.space import Dimension
from torch_iac.worlds.spaces import LEFT_OUT, Flat, FlatWorld, encoder_maker, flattened

PUSH = spaces.Box(-1.0, 1.0, (1,), np.float32)
SMALL = IACConfig(n_candidates=5, max_examples=20, window=8, delay=8, meta=None)


class Spaced(gym.Env[Any, Any]):
    """A world of any spaces, which shows anything and remembers what was done."""

    def __init__(
        self, action_space: spaces.Space[Any], observation_space: spaces.Space[Any], **metadata: Any
    ) -> None:
        self.action_space, self.observation_space = action_space, observation_space
        self.metadata = metadata
        self.done: list[Any] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.done.append(action)
        return self.observation_space.sample(), 0.0, False, False, {}


def flat(
    action_space: spaces.Space[Any] = PUSH,
    observation_space: spaces.Space[Any] = PUSH,
    encoder: str = "pixels",
    **metadata: Any,
) -> Flat:
    return Flat(action_space, observation_space, metadata, encoder_maker(encoder))


def boxes(least: int) -> st.SearchStrategy[spaces.Space[Any]]:
    shapes = st.lists(st.integers(least, 3), max_size=3).map(tuple)
    numbers = st.sampled_from([np.float32, np.float64, np.int64, np.uint8, np.int8])
    return st.builds(lambda shape, dtype: spaces.Box(0, 9, shape, dtype), shapes, numbers)


LEAVES = (
    boxes(least=1)
    | st.builds(
        lambda n, start: spaces.Discrete(n, start=start), st.integers(2, 9), st.integers(-3, 3)
    )
    | st.builds(spaces.MultiDiscrete, st.lists(st.integers(2, 5), min_size=1, max_size=3))
    | st.just(spaces.MultiDiscrete(np.array([[2, 3], [4, 5]]), start=np.array([[1, 0], [-1, 2]])))
    | st.builds(spaces.MultiBinary, st.integers(1, 4) | st.just([2, 2]))
)
ANY_SPACES = st.recursive(
    LEAVES,
    lambda parts: (
        st.builds(spaces.Tuple, st.lists(parts, min_size=1, max_size=3))
        | st.builds(
            spaces.Dict, st.dictionaries(st.sampled_from("abc"), parts, min_size=1, max_size=3)
        )
    ),
    max_leaves=5,
)


@given(ANY_SPACES, st.integers(0, 1000))
def test_what_is_done_is_a_row_in_its_bounds_and_the_row_what_is_done(
    space: spaces.Space[Any], seed: int
) -> None:
    row = flat(action_space=space).actions
    space.seed(seed)
    value = space.sample()
    numbers = row.of_value(value)
    assert len(numbers) == len(row.names) == len(set(row.names)) == len(row.n_values)
    assert ((row.low <= numbers) & (numbers <= row.high)).all()
    back = row.to_value(numbers)
    assert back in space
    assert row.of_value(back).tolist() == numbers.tolist()


@given(ANY_SPACES, st.integers(0, 1000))
def test_any_row_in_the_bounds_is_something_that_can_be_done(
    space: spaces.Space[Any], seed: int
) -> None:
    of = flat(action_space=space)
    share = np.random.default_rng(seed).random(len(of.actions.low))
    numbers = (of.actions.low + share * (of.actions.high - of.actions.low)).astype(np.float32)
    assert of.actions.to_value(numbers) in space


@given(ANY_SPACES, st.integers(0, 1000))
def test_what_is_shown_is_a_row_in_its_bounds(space: spaces.Space[Any], seed: int) -> None:
    of = flat(observation_space=space)
    space.seed(seed)
    numbers = of.sensors.of_value(space.sample())
    assert numbers in of.observation_space
    assert set(of.sensors.n_values) == {None}
    assert len(numbers) == len(set(of.sensors.names))


@given(ANY_SPACES, ANY_SPACES)
def test_a_robot_lives_with_any_spaces(
    action_space: spaces.Space[Any], observation_space: spaces.Space[Any]
) -> None:
    world = Spaced(action_space, observation_space)
    env = FlatWorld(world, "pixels")
    agent = IAC(SensorimotorSpace.from_env(env), SMALL)
    sensors, _ = env.reset(seed=0)
    for _ in range(3):
        action = agent.act(sensors[None])
        sensors, *_ = env.step(action[0])
        step = agent.observe(sensors[None])
        done = env._flat.actions.of_value(world.done[-1])
        assert world.done[-1] in action_space
        assert step.actions[0].numpy() == pytest.approx(done, abs=1e-5)


def test_names_are_paths() -> None:
    inner = spaces.Dict({"place": spaces.Box(0, 1, (2,)), "is_open": spaces.Discrete(2)})
    shown = spaces.Dict(
        {
            "goal": inner,
            "heading": spaces.Discrete(3, start=5),
            "weight": spaces.Box(0, 1, ()),
            "pair": spaces.Tuple((spaces.MultiBinary(2), spaces.Box(0, 1, (1, 2)))),
        }
    )
    of = flat(observation_space=shown)
    value = {
        "goal": {"place": np.array([0.25, 0.5]), "is_open": 1},
        "heading": 6,
        "weight": np.array(0.75),
        "pair": (np.array([0, 1]), np.array([[0.125, 0.0625]])),
    }
    row = dict(zip(of.sensors.names, of.sensors.of_value(value).tolist(), strict=True))
    assert row == {
        "goal/is_open": 1.0,
        "goal/place/0": 0.25,
        "goal/place/1": 0.5,
        "heading/0": 0.0,
        "heading/1": 1.0,
        "heading/2": 0.0,
        "pair/0/0": 0.0,
        "pair/0/1": 1.0,
        "pair/1/0_0": 0.125,
        "pair/1/0_1": 0.0625,
        "weight": 0.75,
    }


@pytest.mark.parametrize(
    ("space", "names"),
    [
        (spaces.Box(0, 1, (2,), np.int8), ["sensor_0", "sensor_1"]),
        (spaces.Box(0, 1, (2, 2)), ["sensor_0_0", "sensor_0_1", "sensor_1_0", "sensor_1_1"]),
        (spaces.Box(0, 1, ()), ["sensor_0"]),
        (spaces.Discrete(2), ["sensor_0"]),
        (spaces.Discrete(3), ["sensor_0", "sensor_1", "sensor_2"]),
        (spaces.MultiDiscrete([7, 8]), ["sensor_0", "sensor_1"]),
    ],
    ids=str,
)
def test_spaces_without_parts_are_numbered(space: spaces.Space[Any], names: list[str]) -> None:
    assert list(flat(observation_space=space).sensors.names) == names


def test_the_worlds_own_names_come_first() -> None:
    world = Spaced(
        spaces.Discrete(3),
        spaces.Box(0, 1, (1, 2)),
        action_names=("turn",),
        sensor_names=("left", "right"),
    )
    space = SensorimotorSpace.from_env(FlatWorld(world))
    assert space.situation_names == ("turn", "left", "right")
    assert space.actions == (Dimension("turn", 0.0, 2.0, 3),)
    world.metadata["sensor_names"] = ("left",)
    with pytest.raises(ValueError, match=r"^sensor_names must name 2 dimensions, got \('left',\)$"):
        SensorimotorSpace.from_env(FlatWorld(world))


@pytest.mark.parametrize(
    ("space", "dimensions"),
    [
        (spaces.Discrete(3, start=4), [Dimension("action_0", 4, 6, 3)]),
        (
            spaces.MultiDiscrete([2, 3]),
            [Dimension("action_0", 0, 1, 2), Dimension("action_1", 0, 2, 3)],
        ),
        (spaces.MultiBinary(1), [Dimension("action_0", 0, 1, 2)]),
        (spaces.Box(-2, 2, (1,), np.int32), [Dimension("action_0", -2, 2, 5)]),
        (
            spaces.Dict({"gear": spaces.Discrete(5), "pedal": spaces.Box(0, 1, (1,))}),
            [Dimension("gear", 0, 4, 5), Dimension("pedal/0", 0, 1)],
        ),
    ],
    ids=str,
)
def test_counted_actions_have_the_values_that_the_world_counts(
    space: spaces.Space[Any], dimensions: list[Dimension]
) -> None:
    world = flat(action_space=space)
    assert list(SensorimotorSpace.from_env(world).actions) == dimensions


def test_texts_in_a_dict_are_left_out() -> None:
    shown = spaces.Dict({"place": PUSH, "order": spaces.Text(9)})
    of = flat(observation_space=shown)
    assert of.sensors.names == ("place/0",)
    assert of.metadata[LEFT_OUT] == ("order",)
    assert of.sensors.of_value({"place": np.array([0.5]), "order": "go"}).tolist() == [0.5]


KINDS = "(Box, Discrete, MultiBinary, MultiDiscrete, or a Dict or Tuple of them)"
NODES = spaces.Graph(node_space=PUSH, edge_space=None)


@pytest.mark.parametrize(
    ("action_space", "observation_space", "sentence"),
    [
        (PUSH, spaces.Text(5), "the observation space must be of numbers {}, got Text"),
        (
            PUSH,
            spaces.Dict({"a": spaces.Text(5)}),
            "the observation space must be of numbers {}, got Dict",
        ),
        (
            PUSH,
            spaces.Dict({"a": spaces.Tuple((PUSH, spaces.Sequence(PUSH)))}),
            "the observation space must be of numbers {}, got Sequence for a/1",
        ),
        (PUSH, NODES, "the observation space must be of numbers {}, got Graph"),
        (
            spaces.Dict({"say": spaces.Text(5), "push": PUSH}),
            PUSH,
            "the action space must be of numbers {}, got Text for say",
        ),
        (
            spaces.OneOf((PUSH, PUSH)),
            PUSH,
            "the action space must be of numbers {}, got OneOf",
        ),
    ],
)
def test_what_is_no_number_is_refused_in_one_sentence(
    action_space: spaces.Space[Any], observation_space: spaces.Space[Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match="must be of numbers") as refused:
        FlatWorld(Spaced(action_space, observation_space))
    assert str(refused.value) == sentence.format(KINDS)


@pytest.mark.parametrize(
    ("action_space", "sentence"),
    [
        (spaces.Discrete(1), r"the bounds of action_0 must be finite and in order, got \[0.0, 0.0"),
        (
            spaces.Box(0, 2**31 - 1, (1,), np.int64),
            "the values of action_0 must number from 2 to 1,048,576, got 2147483648",
        ),
        (spaces.Dict({}), "actions must name at least one dimension, got none"),
    ],
    ids=str,
)
def test_actions_without_a_choice_or_with_too_many_are_refused(
    action_space: spaces.Space[Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=f"^{sentence}"):
        SensorimotorSpace.from_env(FlatWorld(Spaced(action_space, PUSH)))


def test_flat_worlds_stay_as_they_are() -> None:
    world = Spaced(PUSH, spaces.Box(0, 9, (2,), np.uint8))
    assert flattened(world, None) is world
    assert isinstance(flattened(Spaced(spaces.Discrete(2), PUSH), None), FlatWorld)


def test_a_world_that_is_not_flat_is_refused_with_the_way_out() -> None:
    with pytest.raises(ValueError, match=r"flat Box, got Discrete\(2\); FlatWorld makes others"):
        SensorimotorSpace.from_env(Spaced(spaces.Discrete(2), PUSH))
