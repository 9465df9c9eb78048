"""Lives that are lived again: which decisions, and that they come out as recorded."""

from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

import torch_iac_envs  # noqa: F401 - registers the worlds
from tests.synthetic_run import write_run
from torch_iac import IAC, SensorimotorSpace
from torch_iac.replay.scenes import Scene, Stage, find_stages, relive, stages_at
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.recorder import Recorder
from torch_iac.runs.schema import part_path
from torch_iac.training import train
from torch_iac.worlds.vector import World

KEYFRAME: dict[str, Any] = {"keyframe_every": 5}  # so that a stage begins between two
TOY_ROOM = "torch_iac_envs/ToyRoom-v0"
KINEMATIC = "torch_iac_envs/ToyRoomKinematic-v0"


def live(folder: Path, env: World, seeds: tuple[int, ...], n_decisions: int = 12) -> Run:
    """Return the recorded run of robots in a world."""
    agent = IAC(SensorimotorSpace.from_env(env, ["toy_distance"]), seeds=seeds)
    with Recorder(folder, agent, env.metadata["zone_names"]) as recorder:
        train(agent, env, n_decisions, recorder)
    env.close()
    return load_run(folder)


def replayed(run: Run, stages: list[Stage], agent: int = 0) -> list[Scene]:
    """Return the scenes of a run in the kinematic room."""
    camera = gym.make_vec(KINEMATIC, 1, render_mode="rgb_array", width=16, height=12)
    try:
        return list(relive(run, stages, gym.make_vec(KINEMATIC, 1), camera, agent))
    finally:
        camera.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Three robots in the kinematic room."""
    return live(tmp_path_factory.mktemp("run"), gym.make_vec(KINEMATIC, 3), (7, 8, 9))


# Which decisions.


def test_stages_are_the_beginning_each_focus_and_the_end(tmp_path: Path) -> None:
    """The made-up robot plays with f3 from 0.15 of its life on, with f2 from about 0.4 on."""
    run = load_run(write_run(tmp_path, n_decisions=2000))
    begin, f3, f2, end = find_stages(run, n_decisions=30)
    assert (begin, end) == (Stage("The beginning", 0, 30), Stage("The end", 1970, 30))
    assert (f3.title, f2.title) == ("The focus on f3", "The focus on f2")
    focus = run.summary["agents"][0]["focus"]
    assert [f3.first, f2.first] == [focus["f3"] + 110, focus["f2"] + 110]
    zones = run.column("zone")[:, 0]
    for stage, zone in ((f3, 2), (f2, 1)):
        assert (zones[stage.first : stage.first + 30] == zone).mean() > 0.5


def test_a_life_without_focus_has_a_beginning_and_an_end(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path, n_decisions=30, zone_names=None))
    assert [stage.title for stage in find_stages(run)] == ["The beginning", "The end"]
    assert find_stages(run, n_decisions=100) == [Stage("The beginning", 0, 30)]


def test_stages_can_be_chosen_and_end_with_the_run(run: Run) -> None:
    assert stages_at(run, (9, 2), n_decisions=4) == [
        Stage("From decision 2 on", 2, 4),
        Stage("From decision 9 on", 9, 3),
    ]
    with pytest.raises(ValueError, match=r"decisions must lie in \[0, 12\), got 12"):
        stages_at(run, (3, 12))


# Living again.


def test_a_robot_of_many_lives_again_alone(run: Run) -> None:
    scenes = replayed(run, stages_at(run, (2, 10), 3), agent=2)
    assert [scene.row["step"] for scene in scenes] == [2, 3, 4, 10, 11]
    assert {scene.row["seed"] for scene in scenes} == {9}
    assert scenes[0].row == run.table(agent=2).to_pylist()[2]
    assert [len(scene.pictures) for scene in scenes] == [1] * 5


def test_pybullets_room_lives_again_to_the_last_bit_and_is_filmed(tmp_path: Path) -> None:
    run = live(tmp_path, gym.make_vec(TOY_ROOM, 1, "sync", **KEYFRAME), (3,))
    look: dict[str, Any] = {"render_mode": "rgb_array_list", "width": 32, "height": 24, **KEYFRAME}
    world, camera = (gym.make_vec(TOY_ROOM, 1, "sync", **kind) for kind in (KEYFRAME, look))
    scenes = list(relive(run, [Stage("", 7, 2), Stage("", 8, 4)], world, camera))
    assert [scene.row["step"] for scene in scenes] == [7, 8, 8, 9, 10, 11]
    assert {len(scene.pictures) for scene in scenes} == {5}
    for one, other in zip(scenes[1].pictures, scenes[2].pictures, strict=True):
        np.testing.assert_array_equal(one, other)
    world.close()
    camera.close()


class Stairs(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Four steps up, then from the bottom again; its picture is as bright as it is high."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"]}  # type: ignore[misc]

    def __init__(self) -> None:
        self.render_mode, self.full_state = "rgb_array", 0
        self.observation_space = gym.spaces.Box(0, 4, (1,), np.float32)
        self.action_space = gym.spaces.Box(0, 1, (1,), np.float32)

    def reset(self, **_: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        self.full_state = 0
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        del action
        self.full_state += 1
        return np.full(1, self.full_state, np.float32), 0.0, self.full_state == 4, False, {}

    def render(self) -> NDArray[np.uint8]:
        return np.full((2, 2, 3), self.full_state, np.uint8)


def test_a_life_of_many_episodes_lives_again_to_its_last_outcome(tmp_path: Path) -> None:
    first, world, camera = (
        gym.vector.SyncVectorEnv([Stairs], autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
        for _ in range(3)
    )
    agent = IAC(SensorimotorSpace.from_env(first), seeds=[0])
    with Recorder(tmp_path, agent) as recorder:
        train(agent, first, 8, recorder)
    run = load_run(tmp_path)
    assert run.column("outcome/sensor_0")[:, 0].tolist() == [1, 2, 3, 4, 1, 2, 3, 4]
    scenes = list(relive(run, [Stage("", 2, 6)], world, camera))
    assert [int(scene.pictures[0].max()) for scene in scenes] == [3, 0, 1, 2, 3, 0]


@pytest.mark.parametrize(
    ("column", "decision", "message"),
    [
        ("sensor/wall_3", 0, "wall_3 must be .* at decision 0 as .* records, got"),
        ("sensor/toy_distance", 6, "toy_distance must be .* at decision 6 as .* records, got"),
        ("outcome/toy_distance", 11, "the next toy_distance must be .* at decision 11 as .* rec"),
        ("action/left_wheel", 4, "must be .* at decision [45] as .* records, got"),
    ],
)
def test_a_record_that_does_not_come_out_is_refused(
    tmp_path: Path, column: str, decision: int, message: str
) -> None:
    run = live(tmp_path, gym.make_vec(KINEMATIC, 1), (7,))
    path = part_path(run.folder, 0)
    table = pq.read_table(path)
    values = table[column].to_numpy().copy()
    values[decision] = 0.5 * values[decision] + 0.1
    place = table.schema.get_field_index(column)
    pq.write_table(table.set_column(place, column, pa.array(values)), path)
    with pytest.raises(ValueError, match=message):
        replayed(run, stages_at(run, (0,), 12))


def test_a_world_that_cannot_be_saved_cannot_be_handed_over(run: Run) -> None:
    class Closed(gym.vector.VectorEnv[Any, Any, Any]):
        """A world that hides its state."""

        def __init__(self, world: gym.vector.VectorEnv[Any, Any, Any]) -> None:
            self.reset, self.step = world.reset, world.step  # type: ignore[method-assign]
            self.num_envs, self.metadata = world.num_envs, world.metadata

    world = Closed(gym.make_vec(KINEMATIC, 1))
    with pytest.raises(ValueError, match="a world must have get_state and set_state, or worlds"):
        list(relive(run, stages_at(run, (0,)), world, gym.make_vec(KINEMATIC, 1)))
