"""The toy room of batched arithmetic: the contract, independent worlds, and pybullet's motion."""

import copy
import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch import Tensor

from scripts.benchmarks.kinematic_accuracy import compare, landings
from tests.envs.contract import F1, F2, F3, ROOM, ToyRoomContract, pickled
from torch_iac_envs.bodies import CHASSIS, FRICTION, WALL
from torch_iac_envs.kinematic import TOY_BOUNCE, WALL_FRICTION, ToyRoomKinematic, roll
from torch_iac_envs.randomness import normal, pack_seeds, uniform

ID = "torch_iac_envs/ToyRoomKinematic-v0"
CPU = torch.device("cpu")
DEVICES = [
    "cpu",
    pytest.param(
        "cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
    ),
]


class Arrays(gym.vector.VectorWrapper):
    """The worlds' rewards as an array, for the contract's numpy."""

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        sensors, *ends, infos = self.env.step(actions)
        rewards, terminated, truncated = (end.numpy() for end in ends)
        return sensors, rewards, terminated, truncated, infos


class TestContract(ToyRoomContract):
    """The contract, kept by worlds stepped all at once."""

    def make(self, n_worlds: int, **arguments: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
        return Arrays(gym.make_vec(ID, n_worlds, **arguments))


# As a Gymnasium vector environment.


def test_gymnasium_makes_it_with_and_without_a_mode() -> None:
    for mode in (None, "vector_entry_point"):
        env = gym.make_vec(ID, num_envs=3, vectorization_mode=mode)
        assert isinstance(env.unwrapped, ToyRoomKinematic)
        assert env.num_envs == 3
        assert env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.DISABLED
        assert env.observation_space.shape == (3, 11)
        assert env.action_space.shape == (3, 3)


def test_it_says_of_itself_what_the_room_of_pybullet_says() -> None:
    kinematic, physical = (
        gym.make_vec(name, 2, beams=4) for name in (ID, "torch_iac_envs/ToyRoom-v0")
    )
    for key in ("action_names", "sensor_names", "sensor_units", "zone_names"):
        assert kinematic.metadata[key] == physical.metadata[key]
    assert kinematic.single_observation_space == physical.single_observation_space
    assert kinematic.single_action_space == physical.single_action_space
    assert kinematic.observation_space == physical.observation_space
    physical.close()


@pytest.mark.parametrize("device", DEVICES)
def test_tensors_stay_on_the_device(device: str) -> None:
    env = ToyRoomKinematic(5, device=device)
    first, _ = env.reset(seed=0)
    sensors, rewards, terminated, truncated, infos = env.step(_actions(1, 5)[0].to(device))
    assert first.shape == sensors.shape == (5, 11)
    assert first.dtype == sensors.dtype == torch.float32
    assert infos["zone"].dtype == torch.int64
    for ends in (rewards, terminated, truncated, infos["zone"]):
        assert ends.shape == (5,)
        assert ends.device.type == sensors.device.type == first.device.type == device
        assert ends is infos["zone"] or not ends.any()


@pytest.mark.parametrize("call", ["step", "get_state"])
def test_nothing_can_be_asked_before_reset(call: str) -> None:
    arguments = [np.zeros((1, 3), np.float32)] if call == "step" else []
    with pytest.raises(RuntimeError, match=f"reset must be called before {call}"):
        getattr(ToyRoomKinematic(), call)(*arguments)


def test_actions_of_the_wrong_shape_are_refused() -> None:
    env = ToyRoomKinematic(2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions must have shape \(2, 3\), got \(3,\)"):
        env.step(np.zeros(3, np.float32))


def test_a_wrong_action_of_any_world_is_named() -> None:
    env = ToyRoomKinematic(100)
    env.reset(seed=0)
    actions = torch.zeros(100, 3)
    actions[57, 1] = -1.25
    with pytest.raises(ValueError, match=r"right_wheel must lie in \[-1, 1\], got -1.25"):
        env.step(actions)


def test_there_is_a_world_at_least() -> None:
    with pytest.raises(ValueError, match="num_envs must be at least 1 and finite, got 0"):
        ToyRoomKinematic(0)


def test_there_are_as_many_seeds_as_worlds() -> None:
    with pytest.raises(ValueError, match=r"one for each of 3 worlds, got \[1, 2\]"):
        ToyRoomKinematic(3).reset(seed=[1, 2])


def test_a_picture_shows_each_robot_and_its_toy_where_they_are() -> None:
    env = ToyRoomKinematic(2, render_mode="rgb_array", width=80, height=60)
    env.reset(seed=0)
    state = env.get_state()
    state["robot"][:, :2] = torch.tensor([[-0.4, 0.0], [0.4, 0.0]])
    state["toy"] = -state["robot"][:, :2]
    env.set_state(state)
    pictures = env.render()
    assert pictures is not None
    assert [picture.shape for picture in pictures] == [(60, 80, 3)] * 2
    for picture, robot_is_left in zip(pictures, (True, False), strict=True):
        red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
        robot, toy = (np.nonzero(of)[1].mean() for of in (blue > red + green, red > green + blue))
        assert (robot < toy) == robot_is_left
    env.close()


def test_an_unknown_render_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="render_mode must be None or 'rgb_array', got 'human'"):
        ToyRoomKinematic(render_mode="human")


# Seeds and states, to the last bit.


@pytest.mark.parametrize("n_worlds", [7, 4_096])
def test_a_world_of_many_is_that_world_alone(n_worlds: int) -> None:
    actions = _actions(20, n_worlds)
    many = _life(ToyRoomKinematic(n_worlds), actions, seed=3)
    for world in (0, 1, n_worlds // 3, n_worlds - 2, n_worlds - 1):
        alone = _life(ToyRoomKinematic(1), actions[:, world : world + 1], seed=[3 + world])
        assert torch.equal(many[:, world], alone[:, 0])


def test_worlds_without_a_seed_differ_each_time() -> None:
    first, second = (ToyRoomKinematic(2).reset()[0] for _ in range(2))
    assert not torch.allclose(first[0], first[1])
    assert not torch.allclose(first, second)


def test_a_resumed_world_lives_on_as_if_never_interrupted() -> None:
    env, other = ToyRoomKinematic(9), ToyRoomKinematic(9)
    actions = _actions(30, 9)
    _life(env, actions[:15], seed=0)
    state = env.get_state()
    expected = torch.stack([env.step(action)[0] for action in actions[15:]])
    other.set_state(state)
    assert torch.equal(torch.stack([other.step(a)[0] for a in actions[15:]]), expected)
    env.set_state(state)  # no step has changed it
    assert torch.equal(torch.stack([env.step(a)[0] for a in actions[15:]]), expected)


def test_a_state_of_other_worlds_is_refused() -> None:
    env = ToyRoomKinematic(2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"robot must have shape \(3, 3\), got \(2, 3\)"):
        ToyRoomKinematic(3).set_state(env.get_state())


def test_uniform_numbers_are_uniform_and_normal_numbers_normal() -> None:
    seeds = pack_seeds(range(-5_000, 5_000), CPU)
    numbers = torch.cat([uniform(seeds, moment, 10) for moment in range(3)])
    assert 0 <= numbers.min() < 1e-4
    assert 1 - 1e-4 < numbers.max() < 1
    assert numbers.mean().item() == pytest.approx(0.5, abs=0.003)
    assert len(np.unique(numbers.numpy())) > 0.98 * numbers.numel()
    assert torch.corrcoef(numbers).fill_diagonal_(0).abs().max() < 0.05
    numbers = normal(numbers.view(2, -1, 10_000)).flatten(0, 1)
    assert numbers.mean().item() == pytest.approx(0, abs=0.01)
    assert numbers.std().item() == pytest.approx(1, abs=0.01)
    assert (numbers.abs() < 1.96).float().mean().item() == pytest.approx(0.95, abs=0.003)
    assert torch.corrcoef(numbers).fill_diagonal_(0).abs().max() < 0.05


# Motion.


def test_nothing_leaves_the_room() -> None:
    env = ToyRoomKinematic(256, beams=0, check_actions=False)
    env.reset(seed=0)
    draw = torch.Generator().manual_seed(0)
    for _ in range(1_000):
        actions = torch.rand(256, 3, generator=draw)
        actions[:, :2] = 2 * actions[:, :2] - 1
        env.step(actions)
        state = env.get_state()
        x_y, heading = torch.split(state["robot"], [2, 1], 1)
        extent = ROOM.chassis / 2 * (heading.cos().abs() + heading.sin().abs())
        assert (x_y.abs() + extent).max() < ROOM.side / 2 + 1e-6  # and no value that is none
        assert state["toy"].abs().max() <= max(ROOM.toy_reach, ROOM.side / 2 - ROOM.chassis / 2)


def test_a_robot_pushed_flat_against_a_wall_stays_there() -> None:
    env = ToyRoomKinematic(1, sensor_noise=0.0, actuator_noise=0.0)
    env.reset(seed=0)
    state = env.get_state()
    state["robot"] = torch.tensor([[0.3, 0.1, 0.0]])
    env.set_state(state)
    for _ in range(5):
        env.step(torch.tensor([[1.0, 1.0, F2]]))
    expected = torch.tensor([[(ROOM.side - ROOM.chassis) / 2, 0.1, 0.0]])
    torch.testing.assert_close(env.get_state()["robot"], expected, atol=0.02, rtol=0)


def test_motion_is_that_of_pybullet() -> None:
    difference = compare(n_decisions=600, seed=0)
    assert difference.away.displacement < 0.05
    assert difference.away.heading < 0.03
    assert difference.near.displacement < 0.20
    assert difference.near.heading < 0.10


def test_toys_land_where_those_of_pybullet_land() -> None:
    kinematic, physical = landings(n_decisions=600, seed=0)
    quantiles = np.linspace(0.05, 0.95, 10)
    for ours, theirs in zip(kinematic.T, physical.T, strict=True):
        apart = np.abs(np.quantile(ours, quantiles) - np.quantile(theirs, quantiles))
        assert apart.max() < 0.1 * ROOM.side


def test_walls_rub_as_those_of_pybullet() -> None:
    assert pytest.approx(FRICTION[WALL] * FRICTION[CHASSIS]) == WALL_FRICTION


def test_bounces_in_closed_form_are_those_counted_one_by_one() -> None:
    draw = np.random.default_rng(0)
    places, velocities = draw.uniform(-1, 1, 200), draw.uniform(-20, 20, 200)
    expected = [_roll(x, v, 0.7) for x, v in zip(places, velocities, strict=True)]
    ends = roll(torch.tensor(places), torch.tensor(velocities), 0.7, 1.0)
    np.testing.assert_allclose(ends.numpy(), expected, atol=1e-9)


def test_the_beams_and_the_toy_are_where_geometry_says() -> None:
    env = ToyRoomKinematic(64, sensor_noise=0.0)
    sensors, _ = env.reset(seed=0)
    for action in [*_actions(10, 64), torch.tensor([[0.3, -0.2, F3]] * 64)]:
        state = env.get_state()
        for world in range(64):
            x, y, heading = state["robot"][world].tolist()
            expected = _geometry(x, y, heading, *state["toy"][world].tolist())
            np.testing.assert_allclose(sensors[world].numpy(), expected, atol=2e-6)
        sensors = env.step(action)[0]


def _geometry(x: float, y: float, heading: float, toy_x: float, toy_y: float) -> list[float]:
    """Return what a robot without noise senses."""
    walls = []
    for beam in range(8):
        cos, sin = (f(heading + beam * math.pi / 4) for f in (math.cos, math.sin))
        across = (ROOM.side / 2 - math.copysign(x, cos * x)) / abs(cos)
        along = (ROOM.side / 2 - math.copysign(y, sin * y)) / abs(sin)
        walls.append(min(across, along))
    gap = math.hypot(toy_x - x, toy_y - y) - ROOM.toy_radius
    bearing = math.atan2(toy_y - y, toy_x - x) - heading
    toy = [gap, math.cos(bearing), math.sin(bearing)] if gap > 0 else [0.0, 0.0, 0.0]
    return walls + toy


def _roll(x: float, v: float, seconds: float) -> float:
    """Return where a ball between walls at -1 and 1 is, bounce by bounce."""
    while True:
        reached = (math.copysign(1, v) - x) / v
        if reached > seconds:
            return x + v * seconds
        x, v, seconds = math.copysign(1, v), -v * TOY_BOUNCE, seconds - reached


def _actions(n_decisions: int, n_worlds: int) -> Tensor:
    draw = torch.Generator().manual_seed(0)
    actions = torch.rand(n_decisions, n_worlds, 3, generator=draw)
    actions[..., :2] = 2 * actions[..., :2] - 1
    actions[::4, :, 2] = F1
    return actions


def _life(env: ToyRoomKinematic, actions: Tensor, seed: int | list[int]) -> Tensor:
    """Return what is sensed at reset and after each decision, shape `(decisions, A, sensors)`."""
    first, _ = env.reset(seed=seed)
    return torch.stack([first, *(env.step(action)[0] for action in actions)])


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_copies_and_pickles_have_a_camera_of_their_own(
    copied: Callable[[ToyRoomKinematic], ToyRoomKinematic],
) -> None:
    env = ToyRoomKinematic(2, render_mode="rgb_array", width=32, height=24)
    env.reset(seed=1)
    pictures = env.render()
    twin = copied(env)
    twin.step(np.zeros((2, 3), np.float32))
    twin.render()
    twin.close()
    np.testing.assert_array_equal(np.array(env.render()), np.array(pictures))
    env.close()
