from collections import Counter

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_iac.internal.scaling import UNIT_STEP, CountedScale, Scale, action_scale
from torch_iac.space import MOST_VALUES, Dimension, SensorimotorSpace

CPU = torch.device("cpu")


class Wires(gym.Env[np.ndarray, np.ndarray]):
    """A world that is only its spaces."""

    def __init__(self, low: float = 0.0, names: bool = True) -> None:
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,))
        self.observation_space = gym.spaces.Box(low, 4.0, (3,))
        if names:
            self.metadata = {"action_names": ("a", "b"), "sensor_names": ("x", "y", "z")}


def test_a_space_reads_names_and_bounds_from_a_world() -> None:
    space = SensorimotorSpace.from_env(Wires(), outcomes=["y"])
    assert space.situation_names == ("a", "b", "x", "y", "z")
    assert space.outcomes == (Dimension("y", 0.0, 4.0),)
    assert space.outcome_columns == (1,)


def test_a_world_without_names_gets_numbers_and_all_sensors_are_outcomes() -> None:
    space = SensorimotorSpace.from_env(Wires(names=False))
    assert space.situation_names == ("action_0", "action_1", "sensor_0", "sensor_1", "sensor_2")
    assert space.outcomes == space.sensors


def test_vectors_of_worlds_have_the_space_of_one() -> None:
    vector = gym.vector.SyncVectorEnv([Wires, Wires])
    assert SensorimotorSpace.from_env(vector) == SensorimotorSpace.from_env(Wires())


def test_json_returns_the_same_space(space: SensorimotorSpace) -> None:
    assert SensorimotorSpace.from_json(space.to_json()) == space


def test_bad_spaces_are_refused_in_one_sentence() -> None:
    with pytest.raises(ValueError, match=r"outcomes must be sensors \(x, y, z\), got w"):
        SensorimotorSpace.from_env(Wires(), outcomes=["w"])
    with pytest.raises(ValueError, match="outcomes must name at least one dimension, got none"):
        SensorimotorSpace.from_env(Wires(), outcomes=[])
    with pytest.raises(ValueError, match=r"outcomes must have different names, got \['x', 'x'\]"):
        SensorimotorSpace.from_env(Wires(), outcomes=["x", "x"])
    with pytest.raises(ValueError, match="observation space must have finite bounds"):
        SensorimotorSpace.from_env(Wires(low=-np.inf))
    with pytest.raises(ValueError, match=r"of x must be finite and in order, got \[1\.0, 1\.0\]"):
        Dimension("x", 1, 1)


def test_scaling_has_known_answers() -> None:
    scale = Scale([Dimension("x", -1.0, 3.0)], CPU)
    raw = torch.tensor([[-1.0], [0.0], [3.0], [9.0], [-9.0]])
    assert scale.to_unit(raw)[:, 0].tolist() == [0.0, 0.25, 1.0, 1.0, 0.0]
    assert scale.to_raw(torch.tensor([[0.5]])).tolist() == [[1.0]]


@given(st.floats(-2, 5), st.floats(-2, 5))
def test_scaled_values_and_their_midpoints_are_exact_in_float32(a: float, b: float) -> None:
    scale = Scale([Dimension("x", -2.0, 5.0)], CPU)
    units = scale.to_unit(torch.tensor([[a], [b]]))
    steps = units.double() / UNIT_STEP
    assert (steps == steps.round()).all()
    assert (units.sum() / 2).item() == units.double().sum().item() / 2
    assert torch.allclose(scale.to_raw(units), torch.tensor([[a], [b]]), atol=2e-6)


def test_outside_forgives_rounding_and_nothing_else() -> None:
    scale = Scale([Dimension("x", 0.0, 10.0)], CPU)
    raw = torch.tensor([[0.0], [10.005], [10.1], [-0.1], [float("nan")], [float("inf")]])
    assert scale.outside(raw)[:, 0].tolist() == [False, False, True, True, True, True]


# Dimensions that have but some values.


@given(
    st.integers(2, 1000) | st.sampled_from([2**19 + 1, MOST_VALUES]),
    st.integers(-1000, 1000),
    st.sampled_from([0.25, 0.1, 1.0, 3.0]),
    st.floats(0, 1, exclude_max=True, width=32),
)
def test_a_drawn_value_is_one_of_those_there_are_and_scaled_alike_however_it_comes(
    n_values: int, start: int, gap: float, drawn: float
) -> None:
    low = start * gap
    try:
        of = Dimension("x", low, low + (n_values - 1) * gap, n_values)
    except ValueError:  # too many of them, too far from 0, to be told apart
        assert n_values > 2**18
        return
    scale = CountedScale([of], CPU)
    drawn = drawn // UNIT_STEP * UNIT_STEP
    unit = scale.of_drawn(torch.tensor([[drawn]]))
    place = round(unit.item() * (n_values - 1))
    assert 0 <= place <= n_values - 1
    assert place - 0.1 <= drawn * n_values <= place + 1  # as far as float32 tells
    raw = scale.to_raw(unit)
    assert raw.item() == pytest.approx(low + place * gap, rel=1e-6, abs=1e-4 * gap)
    assert unit.item() == pytest.approx(place / (n_values - 1), abs=UNIT_STEP)
    assert (unit / UNIT_STEP).item() % 1 == 0
    assert torch.equal(scale.to_unit(raw), unit)
    scale.check(raw, "agent")
    if gap == 1:
        assert raw.item() == start + place


def test_each_value_is_drawn_equally_often() -> None:
    scale = CountedScale([Dimension("x", 3.0, 5.0, 3), Dimension("y", 0.0, 1.0)], CPU)
    drawn = ((torch.arange(3000.0) + 0.5) / 3000 // UNIT_STEP * UNIT_STEP)[:, None].expand(-1, 2)
    raw = scale.to_raw(scale.of_drawn(drawn))
    assert Counter(raw[:, 0].tolist()) == {3.0: 1000, 4.0: 1000, 5.0: 1000}
    assert torch.equal(raw[:, 1], drawn[:, 1])  # any number will do here


def test_a_value_between_two_is_refused_and_rounding_forgiven() -> None:
    scale = action_scale([Dimension("y", 0.0, 1.0), Dimension("x", 0.0, 2.0, 3)], CPU)
    scale.check(torch.tensor([[0.3, 1.0001]]), "agent")
    sentence = r"^x must be one of 3 values from 0 to 2, got 1\.5 from agent 1$"
    with pytest.raises(ValueError, match=sentence):
        scale.check(torch.tensor([[0.3, 1.0], [0.3, 1.5]]), "agent")
    with pytest.raises(ValueError, match=r"^x must lie in \[0, 2\], got 3 from agent 0$"):
        scale.check(torch.tensor([[0.3, 3.0]]), "agent")


def test_only_counted_actions_cost_more() -> None:
    assert type(action_scale([Dimension("x", 0.0, 2.0)], CPU)) is Scale


@pytest.mark.parametrize("n_values", [-1, 0, 1, MOST_VALUES + 1])
def test_numbers_of_values_have_limits(n_values: int) -> None:
    sentence = f"^the values of x must number from 2 to 1,048,576, got {n_values}$"
    with pytest.raises(ValueError, match=sentence):
        Dimension("x", 0.0, 1.0, n_values)


def test_values_that_float32_cannot_tell_apart_are_refused() -> None:
    Dimension("x", 0.0, 1e3, 1001)
    with pytest.raises(ValueError, match="must be numbers that float32 holds well apart"):
        Dimension("x", 1e7, 1e7 + 1000, 1001)


def test_a_world_may_say_how_many_values_its_actions_have() -> None:
    world = Wires()
    world.metadata = {**world.metadata, "action_values": (None, 5)}
    space = SensorimotorSpace.from_env(world)
    assert space.actions == (Dimension("a", -1.0, 1.0), Dimension("b", -1.0, 1.0, 5))
    assert SensorimotorSpace.from_json(space.to_json()) == space
    world.metadata["action_values"] = (5,)
    with pytest.raises(ValueError, match=r"^action_values must number 2 dimensions, got \(5,\)$"):
        SensorimotorSpace.from_env(world)
