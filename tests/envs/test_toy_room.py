"""The toy room that pybullet simulates: the contract, its physics and its exact resuming."""

import copy
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

from scripts.benchmarks.world_accuracy import compare
from tests.envs.contract import F1, F2, F3, ROOM, ToyRoomContract, pickled
from torch_iac_envs.toy_room import ToyRoom

ID = "torch_iac_envs/ToyRoom-v0"
SPAWNED_ID = f"torch_iac_envs:{ID}"  # tells a worker what to import before it looks the id up

Array = NDArray[np.float32]


class TestContract(ToyRoomContract):
    """The contract, kept by worlds stepped one after the other."""

    def make(self, n_worlds: int, **arguments: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
        return gym.make_vec(SPAWNED_ID, n_worlds, vectorization_mode="sync", **arguments)


# As a Gymnasium environment.


@pytest.mark.parametrize("arguments", [{}, {"beams": 0, "toy_direction": False}])
def test_gymnasium_finds_nothing_to_complain_about(arguments: dict[str, Any]) -> None:
    # Its own check of rendering opens a window, and not every machine has a display.
    check_env(gym.make(ID, **arguments).unwrapped, skip_render_check=True)


def test_worlds_in_other_processes_are_the_same_worlds() -> None:
    ends = []
    for mode, options in (("sync", {}), ("async", {"context": "spawn"})):
        env = gym.make_vec(SPAWNED_ID, 2, vectorization_mode=mode, vector_kwargs=options)
        env.reset(seed=1)
        assert env.metadata["sensor_names"][-3] == "toy_distance"
        ends.append(env.step(np.array([[1, 0.5, F1], [1, 1, F3]], np.float32)))
        env.close()
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    assert [end[4]["zone"].tolist() for end in ends] == [[0, 2]] * 2


def test_names_belong_to_one_world_and_not_to_the_class() -> None:
    env = ToyRoom(beams=2)
    assert env.metadata["sensor_names"][:2] == ("wall_0", "wall_1")
    assert "sensor_names" not in ToyRoom.metadata
    env.close()


@pytest.mark.parametrize("call", ["step", "get_state", "render"])
def test_nothing_can_be_asked_before_reset(call: str) -> None:
    env = ToyRoom(render_mode="rgb_array")
    arguments = [np.zeros(3, np.float32)] if call == "step" else []
    with pytest.raises(RuntimeError, match=f"reset must be called before {call}"):
        getattr(env, call)(*arguments)
    env.close()


def test_an_action_of_the_wrong_shape_is_refused() -> None:
    env = ToyRoom()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"an action must have shape \(3,\), got \(2,\)"):
        env.step(np.zeros(2, np.float32))
    env.close()


@pytest.mark.parametrize("argument", ["keyframe_every", "substeps", "width", "height"])
def test_counts_are_at_least_one(argument: str) -> None:
    with pytest.raises(ValueError, match=f"{argument} must be at least 1 and finite, got 0"):
        ToyRoom(**{argument: 0})  # type: ignore[arg-type]


def test_a_picture_shows_robot_and_toy() -> None:
    env = ToyRoom(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (360, 480, 3)
    red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
    assert (red > green + blue).sum() > 30
    assert (blue > red + green).sum() > 100
    env.close()
    env.close()


def test_a_film_shows_each_tenth_of_a_second_of_the_last_decision() -> None:
    env = ToyRoom(render_mode="rgb_array_list", width=80, height=60)
    assert env.metadata["render_fps"] == 10
    env.reset(seed=0)
    for sound in (F1, F3):
        env.step(np.array([1, -1, sound], np.float32))
        film = env.render() or []
        assert [picture.shape for picture in film] == [(60, 80, 3)] * 5
        assert all((a != b).any() for a, b in pairwise(film))
    red = [int((picture[..., 0] > 150).sum() - (picture[..., 1] > 150).sum()) for picture in film]
    assert red[-1] < min(red[:-1])  # the toy has jumped into the robot
    env.set_state(env.get_state())
    assert env.render() == []
    env.close()


def test_to_be_filmed_changes_nothing() -> None:
    filmed, alone = ToyRoom(render_mode="rgb_array_list", width=8, height=6), ToyRoom()
    filmed.reset(seed=0)
    alone.reset(seed=0)
    for action in _actions(30):
        np.testing.assert_array_equal(filmed.step(action)[0], alone.step(action)[0])
    assert filmed.get_state()["present"].tobytes() == alone.get_state()["present"].tobytes()
    filmed.close()
    alone.close()


def test_an_unknown_render_mode_is_refused() -> None:
    with pytest.raises(ValueError, match=r"render_mode must be one of .*, got 'ansi'"):
        ToyRoom(render_mode="ansi")


@pytest.mark.skipif(sys.platform != "linux", reason="only there does a variable name the display")
def test_a_window_needs_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match="'human' needs a display"):
        ToyRoom(render_mode="human")


# Physics.


def test_the_beams_agree_with_geometry() -> None:
    env = ToyRoom(sensor_noise=0.0, actuator_noise=0.0)
    sensors, _ = env.reset(seed=0)
    for action in _actions(50):
        x, y, _, i, j, k, w = env.get_state()["present"][:7]
        heading = np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
        directions = heading + np.arange(8) * np.pi / 4
        across = (ROOM.side / 2 - np.sign(np.cos(directions)) * x) / np.abs(np.cos(directions))
        along = (ROOM.side / 2 - np.sign(np.sin(directions)) * y) / np.abs(np.sin(directions))
        np.testing.assert_allclose(sensors[:8], np.minimum(across, along), atol=1e-4)
        sensors = env.step(action)[0]
    env.close()


def test_the_toys_distance_and_direction_agree_with_geometry() -> None:
    env = ToyRoom(sensor_noise=0.0, actuator_noise=0.0)
    sensors, _ = env.reset(seed=0)
    for action in _actions(50):
        present = env.get_state()["present"]
        gap = float(np.linalg.norm(present[17:19] - present[:2])) - ROOM.toy_radius
        np.testing.assert_allclose(sensors[8], max(gap, 0), atol=1e-3)
        assert np.linalg.norm(sensors[9:]) == pytest.approx(float(gap > 0), abs=1e-5)
        sensors = env.step(action)[0]
    env.close()


def test_in_f2_the_toy_stays_though_the_robot_drives_through_it() -> None:
    env = ToyRoom()
    env.reset(seed=0)
    env.step(np.array([0, 0, F3], np.float32))
    places = []
    for wheels in [(1, 1), (-1, -1), (1, 0.5), (-1, -0.5)]:
        env.step(np.array([*wheels, F2], np.float32))
        places.append(env.get_state()["present"][17:20])
    np.testing.assert_allclose(places, [places[0]] * 4, atol=1e-4)
    env.close()


def test_a_decision_begins_with_the_robot_at_rest() -> None:
    env = ToyRoom()
    env.reset(seed=0)
    for action in _actions(100):
        env.step(action)
        speed = np.linalg.norm(env.get_state()["present"][7:10])
        assert speed < 0.15 * ROOM.full_speed
    env.close()


def test_a_finer_time_step_leads_to_the_same_place() -> None:
    difference = compare(n_decisions=300, substeps=8, seed=0)
    assert difference.displacement < 0.02
    assert difference.heading < 0.02


def test_nothing_falls_over_or_gets_lost() -> None:
    env = ToyRoom(beams=0, toy_direction=False)
    env.reset(seed=0)
    for action in _actions(3_000):
        env.step(action)
        present = env.get_state()["present"]
        assert np.isfinite(present).all()
        assert np.abs(present[[0, 1, 17, 18]]).max() < ROOM.side / 2
        assert np.linalg.norm(present[3:5]) < 0.02  # half of the tilt (rad)
        np.testing.assert_allclose(
            present[[2, 19]], [ROOM.wheel_radius, ROOM.toy_radius], atol=0.01
        )
    env.close()


# Repeating and resuming, to the last bit.

RESUMED = """
import sys
import numpy as np
from tests.envs.test_toy_room import resumed_hashes
print(*resumed_hashes(sys.argv[1:]))
"""


def test_the_same_seed_gives_the_same_bits_in_another_process() -> None:
    code = "from tests.envs.test_toy_room import life_hash; print(life_hash(2_000))"
    assert _run(code) == life_hash(2_000)


def test_a_resumed_world_lives_on_as_if_never_interrupted(tmp_path: Path) -> None:
    env = ToyRoom(keyframe_every=10)
    env.reset(seed=0)
    actions, moments, files = _actions(60), (10, 11, 15, 19), []
    for decision, action in enumerate(actions):
        if decision in moments:
            files.append(tmp_path / f"{decision}.npz")
            np.savez(files[-1], allow_pickle=False, **env.get_state())
        env.step(action)
    expected = [_hash_of_state(env)] * len(moments)
    env.close()
    assert _run(RESUMED, *map(str, files)).split() == expected


def test_a_state_of_another_physics_is_refused() -> None:
    env, other = ToyRoom(), ToyRoom(substeps=6)
    env.reset(seed=0)
    env.step(np.array([1, 0.5, F2], np.float32))
    with pytest.raises(RuntimeError, match="must be exactly the one saved, got a difference of"):
        other.set_state(env.get_state())
    with pytest.raises(RuntimeError, match="reset must be called before step"):
        other.step(np.array([1, 0.5, F2], np.float32))
    env.close()
    other.close()


def test_a_state_longer_than_a_keyframe_is_refused() -> None:
    env, other = ToyRoom(), ToyRoom(keyframe_every=2)
    env.reset(seed=0)
    for action in _actions(3):
        env.step(action)
    with pytest.raises(ValueError, match="fewer commands than keyframe_every = 2, got 3"):
        other.set_state(env.get_state())
    env.close()
    other.close()


def life_hash(n_decisions: int) -> str:
    """Return a hash of all that a robot senses in its life."""
    env = ToyRoom()
    digest = hashlib.sha256(env.reset(seed=11)[0].tobytes())
    for action in _actions(n_decisions):
        digest.update(env.step(action)[0].tobytes())
    env.close()
    return digest.hexdigest()


def resumed_hashes(files: list[str]) -> list[str]:
    """Return what becomes of each state when it lives through the rest of the 60 decisions."""
    hashes = []
    for file in files:
        env = ToyRoom(keyframe_every=10)
        with np.load(file) as state:
            env.set_state(dict(state))
        for action in _actions(60)[int(Path(file).stem) :]:
            env.step(action)
        hashes.append(_hash_of_state(env))
        env.close()
    return hashes


def _hash_of_state(env: ToyRoom) -> str:
    arrays = env.get_state().values()
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def _actions(n_decisions: int) -> list[Array]:
    draw = np.random.default_rng(0)
    return list(draw.uniform((-1, -1, 0), 1, (n_decisions, 3)).astype(np.float32))


def _run(code: str, *arguments: str) -> str:
    path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return done.stdout.split("\n")[-2]


# The physics engine as a package.


def said_by_python(code: str) -> str:
    """Return what a fresh Python writes to stdout and stderr, C's own lines too."""
    words = [sys.executable, "-c", f"import gymnasium, sys, torch_iac_envs\n{code}"]
    answer = subprocess.run(words, capture_output=True, text=True, timeout=900, check=False)
    return answer.stdout + answer.stderr


def test_nothing_is_said_when_the_engine_is_imported() -> None:
    assert said_by_python(f"gymnasium.make({ID!r}); print('made')") == "made\n"


def test_without_the_engine_a_sentence_says_what_to_install() -> None:
    make = f"sys.modules['pybullet'] = None\ngymnasium.make({ID!r})"
    last = said_by_python(make).splitlines()[-1]
    assert last == (
        "gymnasium.error.DependencyNotInstalled: the toy room needs pybullet: "
        "pip install pybullet, or pybullet-arm64 for Python 3.12 and later"
    )


def test_without_the_engine_there_is_the_kinematic_room() -> None:
    room = "torch_iac_envs/ToyRoomKinematic-v0"
    make = f"sys.modules['pybullet'] = None\ngymnasium.make_vec({room!r}, 2); print('made')"
    assert said_by_python(make) == "made\n"


# Copies.


@pytest.mark.parametrize("render_mode", [None, "rgb_array", "rgb_array_list"])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_copies_and_pickles_have_an_engine_of_their_own(
    copied: Callable[[ToyRoom], ToyRoom], render_mode: str | None
) -> None:
    env = ToyRoom(render_mode=render_mode, keyframe_every=3, width=32, height=24)
    env.reset(seed=1)
    for _ in range(4):
        env.step(np.array([1.0, 0.2, F1], np.float32))
    twin = copied(env)
    twin.reset(seed=2)
    twin = copied(env)
    np.testing.assert_array_equal(np.array(twin.render()), np.array(env.render()))
    action = np.array([0.3, 1.0, F1], np.float32)
    moved = [twin.step(action)[0] for _ in range(4)]
    twin.close()
    np.testing.assert_array_equal(moved, [env.step(action)[0] for _ in range(4)])
    env.close()
    closed = copied(env)
    closed.close()


def test_a_window_is_not_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    env = ToyRoom()
    monkeypatch.setattr(env._physics, "_window", True)
    with pytest.raises(TypeError, match=r"a room with a window .* must not be copied"):
        copy.deepcopy(env)
    env.close()
