import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_iac.internal.scaling import UNIT_STEP, Scale
from torch_iac.space import Dimension, SensorimotorSpace

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
