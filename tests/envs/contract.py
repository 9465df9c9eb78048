"""What every toy room keeps to, whatever simulates it: subclass it and say how to make one.

Worlds are driven through Gymnasium's vector interface, as an agent drives them.
"""

import copy
import math
import pickle
from itertools import islice
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

from torch_iac_envs.room import Room

Array = NDArray[np.float32]

ROOM = Room()
F1, F2, F3 = 0.1, 0.5, 0.9
STILL_F1, STILL_F2, STILL_F3 = ([0.0, 0.0, sound] for sound in (F1, F2, F3))
QUIET = {"sensor_noise": 0.0, "actuator_noise": 0.0}


def pickled(world: Any) -> Any:
    """Return what comes out of a pickle."""
    return pickle.loads(pickle.dumps(world))


class ToyRoomContract:
    """Names, bounds, seeds, noise, zones, motion and errors of a toy room."""

    def make(self, n_worlds: int, **arguments: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
        """Return `n_worlds` worlds that take and give arrays."""
        raise NotImplementedError

    # What it says of itself.

    @pytest.mark.parametrize("beams", [0, 1, 8, 12])
    @pytest.mark.parametrize("toy_direction", [True, False])
    def test_names_and_bounds_fit_the_sensors(self, beams: int, toy_direction: bool) -> None:
        env = self.make(1, beams=beams, toy_direction=toy_direction)
        names = env.metadata["sensor_names"]
        expected = [f"wall_{i}" for i in range(beams)] + ["toy_distance"]
        expected += ["toy_cos", "toy_sin"] if toy_direction else []
        assert list(names) == expected
        box = env.single_observation_space
        assert isinstance(box, gym.spaces.Box)
        assert box.shape == (len(names),)
        assert box.dtype == np.float32
        assert np.isfinite(box.low).all()
        assert np.isfinite(box.high).all()
        env.close()

    def test_actions_are_two_wheels_and_a_sound(self) -> None:
        env = self.make(1)
        box = env.single_action_space
        assert isinstance(box, gym.spaces.Box)
        assert env.metadata["action_names"] == ("left_wheel", "right_wheel", "sound")
        np.testing.assert_array_equal(box.low, [-1, -1, 0])
        np.testing.assert_array_equal(box.high, [1, 1, 1])
        env.close()

    def test_readings_stay_within_the_bounds_however_loud_the_noise(self) -> None:
        env = self.make(1, sensor_noise=1.0)
        box = env.single_observation_space
        for sensors in _live(env, _random_actions(100), seed=0):
            assert sensors.dtype == np.float32
            assert box.contains(sensors)
        env.close()

    def test_no_reward_and_no_end(self) -> None:
        env = self.make(2)
        env.reset(seed=0)
        _, rewards, terminated, truncated, _ = env.step(np.array([STILL_F2] * 2, np.float32))
        assert not np.any(rewards)
        assert not np.any(terminated)
        assert not np.any(truncated)
        env.close()

    # Seeds.

    def test_a_seed_decides_everything(self) -> None:
        first, again, other = (
            np.stack(_live(env, _random_actions(60), seed=seed))
            for env, seed in ((self.make(1), 3), (self.make(1), 3), (self.make(1), 4))
        )
        np.testing.assert_array_equal(first, again)
        assert not np.allclose(first, other)

    def test_a_reset_without_a_seed_goes_on(self) -> None:
        env = self.make(1)
        first = np.asarray(env.reset(seed=0)[0])
        second = np.asarray(env.reset()[0])
        again = np.asarray(env.reset(seed=0)[0])
        np.testing.assert_array_equal(first, again)
        assert not np.allclose(first, second)
        env.close()

    def test_robot_and_toy_start_anywhere(self) -> None:
        env = self.make(16, **QUIET)
        sensors = np.asarray(env.reset(seed=0)[0])
        assert (sensors.std(axis=0) > 0.1).all()
        env.close()

    # Copies.

    @pytest.mark.parametrize("n_decisions", [None, 0, 103])
    def test_a_copy_is_a_world_of_its_own(self, n_decisions: int | None) -> None:
        env = self.make(1)
        if n_decisions is not None:
            _live(env, _random_actions(n_decisions), seed=0, close=False)
        twin = copy.deepcopy(env)
        lives = []
        for world in (twin, env):
            if n_decisions is None:
                world.reset(seed=0)
            lives.append(
                [
                    np.asarray(world.step(np.array([action], np.float32))[0]).copy()
                    for action in _random_actions(6)
                ]
            )
            world.close()
        np.testing.assert_array_equal(lives[0], lives[1])

    # Zones.

    @pytest.mark.parametrize(
        ("sound", "zone"),
        [
            (0.0, 0),
            (1 / 3, 0),
            (np.nextafter(np.float32(1 / 3), np.float32(1)), 1),
            (2 / 3, 1),
            (np.nextafter(np.float32(2 / 3), np.float32(1)), 2),
            (1.0, 2),
        ],
    )
    def test_the_sound_decides_the_zone(self, sound: float, zone: int) -> None:
        assert self.zone_of(sound) == zone

    @pytest.mark.parametrize(
        ("sound", "zone"), [(0.0, 0), (0.8, 0), (0.81, 1), (0.9, 1), (0.91, 2), (1.0, 2)]
    )
    def test_zones_end_where_they_are_told_to(self, sound: float, zone: int) -> None:
        assert self.zone_of(sound, f1_end=0.8, f2_end=0.9) == zone

    def test_a_zone_may_be_left_out(self) -> None:
        assert self.zone_of(0.5, f1_end=0.5, f2_end=0.5) == 0
        assert self.zone_of(0.51, f1_end=0.5, f2_end=0.5) == 2

    @pytest.mark.parametrize("ends", [(0.9, 0.8), (-0.1, 0.5), (0.5, 1.1), (math.nan, 0.5)])
    def test_zones_that_do_not_go_up_are_refused(self, ends: tuple[float, float]) -> None:
        with pytest.raises(ValueError, match=r"f1_end and f2_end must go up within \[0, 1\]"):
            self.make(1, f1_end=ends[0], f2_end=ends[1])

    def zone_of(self, sound: float, **arguments: Any) -> int:
        env = self.make(1, **arguments)
        env.reset(seed=0)
        *_, infos = env.step(np.array([[0, 0, sound]], np.float32))
        env.close()
        return int(infos["zone"][0])

    def test_in_f2_nothing_goes_anywhere_while_the_wheels_stand(self) -> None:
        env = self.make(1, **QUIET)
        readings = np.stack(_live(env, [STILL_F1] + [STILL_F2] * 20, seed=1)[2:])
        assert np.abs(readings[1:] - readings[:-1]).mean() < 2e-3

    def test_in_f3_the_toy_is_in_the_robot_however_it_drives(self) -> None:
        env = self.make(1, **QUIET)
        for sensors in _live(env, [[1.0, -0.3, F3], [0.5, 1.0, F3]], seed=2)[1:]:
            np.testing.assert_array_equal(sensors[-3:], [0, 0, 0])

    def test_after_f3_the_robot_drives_away_from_a_toy_that_stays(self) -> None:
        env, covered = self.make(1, **QUIET), ROOM.full_speed * ROOM.drive_seconds
        for _, before, after in _lives_in_the_open(env, [STILL_F3, [1.0, 1.0, F2]]):
            assert not before[8:].any()
            np.testing.assert_allclose(after[8], covered - ROOM.toy_radius, rtol=0.06)
            np.testing.assert_allclose(after[9:], [-1, 0], atol=0.05)
        env.close()

    def test_in_f1_the_toy_may_land_anywhere(self) -> None:
        env = self.make(1, beams=0, **QUIET)
        distances = np.stack(_live(env, [STILL_F1] * 300, seed=0))[:, 0]
        assert abs(np.corrcoef(distances[:-1], distances[1:])[0, 1]) < 0.2
        assert distances.std() > 0.1 * ROOM.diagonal
        env.close()

    def test_a_toy_that_rested_long_can_be_moved(self) -> None:
        env = self.make(1, **QUIET)
        *_, rested, moved = _live(env, [STILL_F2] * 50 + [STILL_F1], seed=0)
        assert np.abs(moved[-3:] - rested[-3:]).max() > 0.05

    # Motion.

    def test_the_robot_drives_straight_towards_the_wall_ahead(self) -> None:
        env, covered = self.make(1, **QUIET), ROOM.full_speed * ROOM.drive_seconds
        for before, after in _lives_in_the_open(env, [[1.0, 1.0, F2]]):
            np.testing.assert_allclose(before[0] - after[0], covered, rtol=0.06)
        env.close()

    def test_wheels_that_oppose_each_other_turn_the_ring_of_beams(self) -> None:
        env = self.make(1, **QUIET)
        wheel = np.pi / 4 * ROOM.track / (2 * ROOM.full_speed * ROOM.drive_seconds)
        for seed in range(5):
            before, after = _live(env, [[-wheel, wheel, F2]], seed=seed, close=False)
            # An eighth of a turn anticlockwise: each beam is where the next one was.
            np.testing.assert_allclose(after[:8], np.roll(before[:8], -1), atol=0.05)
        env.close()

    def test_walls_stop_the_robot(self) -> None:
        env = self.make(1, **QUIET)
        *_, sensors = _live(env, [[1.0, 1.0, F2]] * 30, seed=0)
        assert ROOM.chassis / 2 - 0.01 < sensors[:8].min() < ROOM.chassis
        assert sensors[0] < ROOM.chassis

    # Noise.

    def test_sensor_noise_has_the_deviation_asked_for(self) -> None:
        env = self.make(1, sensor_noise=0.02, actuator_noise=0.0)
        readings = np.stack(_live(env, [STILL_F2] * 200, seed=5))[2:]
        np.testing.assert_allclose(readings[:, :8].std(axis=0).mean(), 0.02, rtol=0.1)

    def test_actuator_noise_moves_a_robot_told_to_stand(self) -> None:
        env = self.make(1, sensor_noise=0.0, actuator_noise=0.05)
        first, *_, last = _live(env, [STILL_F2] * 50, seed=5)
        assert np.abs(first[:8] - last[:8]).max() > 0.01

    # Errors.

    @pytest.mark.parametrize(
        ("action", "message"),
        [
            ([1.5, 0, 0], r"left_wheel must lie in \[-1, 1\], got 1.5"),
            ([0, -2, 0], r"right_wheel must lie in \[-1, 1\], got -2"),
            ([0, 0, -0.1], r"sound must lie in \[0, 1\], got -0.1"),
            ([0, np.nan, 0], r"right_wheel must lie in \[-1, 1\], got nan"),
            ([np.inf, 0, 0], r"left_wheel must lie in \[-1, 1\], got inf"),
        ],
    )
    def test_a_wrong_action_changes_nothing(self, action: list[float], message: str) -> None:
        env, twin = self.make(1), self.make(1)
        env.reset(seed=0)
        twin.reset(seed=0)
        with pytest.raises(ValueError, match=message):
            env.step(np.array([action], np.float32))
        valid = np.array([[0.3, 0.9, F1]], np.float32)
        np.testing.assert_array_equal(env.step(valid)[0], twin.step(valid)[0])
        env.close()
        twin.close()

    @pytest.mark.parametrize(
        ("argument", "value"),
        [("beams", -1), ("sensor_noise", -1.0), ("sensor_noise", np.nan), ("actuator_noise", -0.1)],
    )
    def test_a_wrong_argument_is_named(self, argument: str, value: float) -> None:
        with pytest.raises(ValueError, match=f"{argument} must be at least 0.*, got {value}"):
            self.make(1, **{argument: value})


def _lives_in_the_open(
    env: gym.vector.VectorEnv[Any, Any, Any], actions: list[list[float]]
) -> list[list[Array]]:
    """Return what is sensed in lives that begin where no wall is in the way of one decision."""
    clear = ROOM.full_speed * ROOM.drive_seconds + ROOM.chassis
    first = ((seed, np.asarray(env.reset(seed=seed)[0])[0, :8].min()) for seed in range(500))
    seeds = list(islice((seed for seed, nearest in first if nearest > clear), 3))
    assert len(seeds) == 3
    return [_live(env, actions, seed, close=False) for seed in seeds]


def _random_actions(n_decisions: int) -> list[list[float]]:
    draw = np.random.default_rng(0)
    actions: list[list[float]] = draw.uniform((-1, -1, 0), 1, (n_decisions, 3)).tolist()
    return actions


def _live(
    env: gym.vector.VectorEnv[Any, Any, Any],
    actions: list[list[float]],
    seed: int,
    close: bool = True,
) -> list[Array]:
    """Return what the first world's robot senses at reset and after each action."""
    readings = [np.asarray(env.reset(seed=seed)[0])[0]]
    for action in actions:
        readings.append(np.asarray(env.step(np.array([action], np.float32))[0])[0])
    if close:
        env.close()
    return [reading.copy() for reading in readings]
