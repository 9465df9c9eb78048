"""Bounds that a world leaves open."""

from collections.abc import Callable
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from torch_iac.worlds.bounds import Bounds, bounds_of, found_bounds, parse_bounds

Sensors = NDArray[np.float64]
INF = np.inf
ANYTHING = Box(-INF, INF, (2,), np.float64)
N_DECISIONS = 500


class Open(gym.Env[Sensors, Sensors]):
    """One sensor reads twice the action, the other a number that it never leaves.

    Every tenth decision ends an episode, in which the first sensor reads 7.
    """

    def __init__(self, box: Box = ANYTHING, still: float = 3.0) -> None:
        self.action_space: Box[Any] = Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space: Box[Any] = box
        self._still, self._moment = still, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Sensors, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self._moment = 0
        return np.array([0.0, self._still]), {}

    def step(self, action: Sensors) -> tuple[Sensors, SupportsFloat, bool, bool, dict[str, Any]]:
        self._moment += 1
        is_over = self._moment == 10
        first = 7.0 if is_over else 2.0 * float(action[0])
        return np.array([first, self._still]), 0.0, is_over, False, {}


def vector(maker: Callable[[], gym.Env[Sensors, Sensors]] = Open) -> SyncVectorEnv:
    return SyncVectorEnv([maker], autoreset_mode=AutoresetMode.SAME_STEP)


def bounds_for(
    given: dict[str, tuple[float, float]], maker: Callable[[], gym.Env[Sensors, Sensors]] = Open
) -> Bounds | None:
    return bounds_of(vector(maker), given, N_DECISIONS, lambda: vector(maker))


def test_found_bounds_are_a_tenth_outside_of_what_was_read() -> None:
    low, high = found_bounds(vector(), N_DECISIONS)
    span = 7.0 - -2.0  # the last reading of an episode counts too
    assert low[0] == pytest.approx(-2.0 - 0.1 * span, abs=0.1)
    assert high[0] == pytest.approx(7.0 + 0.1 * span, abs=0.1)


@pytest.mark.parametrize(("still", "bounds"), [(0.0, (-1, 1)), (3.0, (0, 6)), (-1e6, (-2e6, 0))])
def test_a_sensor_that_never_moves_has_room_of_its_size(
    still: float, bounds: tuple[float, float]
) -> None:
    low, high = found_bounds(vector(lambda: Open(still=still)), N_DECISIONS)
    assert (low[1], high[1]) == bounds


def test_the_same_bounds_are_found_every_time() -> None:
    world = vector()
    world.reset(seed=[5])
    once, again = found_bounds(vector(), N_DECISIONS), found_bounds(world, N_DECISIONS)
    np.testing.assert_array_equal(once, again)


def test_bounds_that_a_world_has_are_its_own() -> None:
    assert bounds_for({}, lambda: Open(Box(-9.0, 9.0, (2,)))) is None


@pytest.mark.parametrize("none", [INF, float(np.finfo(np.float32).max)])
def test_only_what_is_open_is_found(none: float) -> None:
    box = Box(np.array([-100.0, -none]), np.array([none, none]), dtype=np.float64)
    bounds = bounds_for({}, lambda: Open(box))
    assert bounds is not None
    assert bounds.found == ("sensor_0", "sensor_1")
    assert bounds.box.low.tolist() == [-100.0, 0.0]
    assert bounds.box.high[0] == pytest.approx(7.9, abs=0.1)


def test_given_bounds_come_first() -> None:
    bounds = bounds_for({"sensor_0": (-1.0, 1.0), "sensor_1": (2.0, 4.0)})
    assert bounds is not None
    assert bounds.box.low.tolist() == [-1.0, 2.0]
    assert bounds.box.high.tolist() == [1.0, 4.0]
    assert (bounds.given, bounds.found) == (("sensor_0", "sensor_1"), ())


def test_bounds_must_be_of_a_sensor() -> None:
    with pytest.raises(ValueError, match="bounds must be of sensor_0, sensor_1, got smell"):
        bounds_for({"smell": (0.0, 1.0)})


def test_what_lies_beyond_is_read_as_the_bound_also_when_an_episode_ends() -> None:
    bounds = bounds_for({"sensor_0": (-1.0, 1.0)})
    assert bounds is not None
    world = bounds.clip(vector())
    world.reset(seed=0)
    ends: list[float] = []
    for push in (0.9, 0.25, *[-0.9] * 8):
        sensors, *_, info = world.step(np.array([[push]], np.float32))
        last: Any = info.get("final_obs", sensors)
        ends.append(float(last[0][0]))
    assert ends == [1.0, 0.5, *[-1.0] * 7, 1.0]


def test_no_number_is_not_taken_for_a_bound() -> None:
    """So that the agent still refuses it."""
    bounds = bounds_for({})
    assert bounds is not None
    world = bounds.clip(vector(lambda: Open(still=np.nan)))
    sensors, _ = world.reset(seed=0)
    assert np.isnan(sensors[0][1])


def test_bounds_are_written_by_name() -> None:
    written = parse_bounds(["sensor_0=-1,2.5", "a=b=0,1e3"])
    assert written == {"sensor_0": (-1.0, 2.5), "a=b": (0.0, 1000.0)}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("sensor_0", "sensor bounds must be written name=low,high, got sensor_0"),
        ("sensor_0=1", "sensor bounds must be written name=low,high, got sensor_0=1"),
        ("sensor_0=1,2,3", "sensor bounds must be written name=low,high, got sensor_0=1,2,3"),
        ("sensor_0=a,b", "sensor bounds must be written name=low,high, got sensor_0=a,b"),
        ("sensor_0=2,1", "the bounds of sensor_0 must be finite and in order, got [2.0, 1.0]"),
        ("sensor_0=0,inf", "the bounds of sensor_0 must be finite and in order, got [0.0, inf]"),
    ],
)
def test_bounds_that_cannot_be_are_refused(text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match="must be") as refused:
        parse_bounds([text])
    assert str(refused.value) == sentence
