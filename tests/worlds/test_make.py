"""The worlds that the command makes: any of Gymnasium's."""

import logging
import re
from importlib.util import find_spec
from pathlib import Path

import gymnasium as gym
import numpy as np
import pyarrow as pa
import pytest

from tests.cli.test_cli import train, typed
from torch_iac.runs.reader import Run, load_run

SPLITTING = ["--max-examples=20", "--window=8", "--delay=8", "--n-candidates=5", "--no-mp"]
"""Regions split often, so that a short run shows much."""

needs_mujoco = pytest.mark.skipif(not find_spec("mujoco"), reason="needs the extra mujoco")

CUSTOM = """
import gymnasium as gym
import numpy as np

class Echo(gym.Env):
    metadata = {"action_names": ("push",), "sensor_names": ("echo",)}

    def __init__(self, loudness: float = 1.0, fails: bool = False, parts: int = 1) -> None:
        self.part = 1 / parts
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (1,), np.float32)
        self.loudness, self.fails = loudness, fails

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self.fails:
            raise RuntimeError("the world cannot begin")
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return self.loudness * np.asarray(action, np.float32), 0.0, False, False, {}

gym.register("custom/Echo-v0", Echo)
"""


@pytest.fixture
def custom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the command calls a world of the user's own, in a module that nobody imported."""
    (tmp_path / "user").mkdir()
    (tmp_path / "user" / "custom_echo_world.py").write_text(CUSTOM)
    monkeypatch.syspath_prepend(tmp_path / "user")
    monkeypatch.delitem(gym.registry, "custom/Echo-v0", raising=False)
    monkeypatch.delitem(__import__("sys").modules, "custom_echo_world", raising=False)
    return "custom_echo_world:custom/Echo-v0"


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of 60 decisions in a public world, with episodes of ten."""
    folder = tmp_path_factory.mktemp("pendulum") / "a"
    options = "--world Pendulum-v1 --world-options max_episode_steps=10 g=9.81"
    return train(folder, *options.split(), *SPLITTING, steps=60)


def test_a_public_world_writes_a_whole_run_folder(pendulum: Run) -> None:
    assert pendulum.config["world"] == "Pendulum-v1"
    assert pendulum.config["world_options"] == {"max_episode_steps": 10, "g": 9.81}
    assert pendulum.n_decisions == 60
    assert pendulum.zone_names == ()
    assert [outcome.name for outcome in pendulum.space.outcomes] == [
        f"sensor_{i}" for i in (0, 1, 2)
    ]
    assert (pendulum.folder / "figures" / "experts.png").stat().st_size
    assert len(pendulum.regions) > 1


def test_the_outcome_that_ends_an_episode_is_what_the_world_showed_before_the_next(
    pendulum: Run,
) -> None:
    speed, next_speed = pendulum.column("sensor/sensor_2"), pendulum.column("outcome/sensor_2")
    goes_on = speed[1:, 0] == next_speed[:-1, 0]
    assert np.flatnonzero(~goes_on).tolist() == [9, 19, 29, 39, 49]
    torque = pendulum.column("action/action_0")[:, 0]
    cos, sin = (pendulum.column(f"sensor/sensor_{i}")[:, 0] for i in (0, 1))
    assert np.hypot(cos, sin) == pytest.approx(np.ones(60), abs=1e-5)
    physics = speed[:, 0] + 0.05 * (1.5 * 9.81 * sin + 3.0 * torque)  # Pendulum-v1's own
    assert next_speed[:, 0] == pytest.approx(np.clip(physics, -8, 8), abs=1e-4)


def test_a_run_goes_on_as_if_it_had_never_ended(pendulum: Run, tmp_path: Path) -> None:
    folder = tmp_path / "a"
    options = "--world Pendulum-v1 --world-options max_episode_steps=10 g=9.81"
    train(folder, *options.split(), *SPLITTING, steps=25)
    answer = typed("resume", folder, "--steps", "60")
    assert (answer.code, answer.err) == (0, "")
    assert load_run(folder).steps == pendulum.steps
    assert load_run(folder).regions == pendulum.regions


def test_the_report_of_a_world_without_zones_speaks_of_none(tmp_path: Path) -> None:
    words = "--world MountainCarContinuous-v0 --outcomes sensor_1 --agents 2"
    answer = typed("train", "--out", tmp_path / "a", "--steps", "60", *words.split(), *SPLITTING)
    assert answer.code == 0
    lines = answer.out.splitlines()
    assert lines[0].startswith("Each of 2 robots took 60 decisions")
    assert all(re.match(r"First cut: (action|sensor)_\d at ", line) for line in lines[1:-1])
    assert lines[-1].startswith("Look at ")


def test_an_action_can_be_held(tmp_path: Path) -> None:
    words = ["--world", "Pendulum-v1", "--hold", "2", *SPLITTING]
    run = train(tmp_path / "a", *words, steps=30)
    assert run.config["hold"] == 2
    speed, cos, sin = (run.column(f"sensor/sensor_{i}")[:, 0] for i in (2, 0, 1))
    torque, next_speed = run.column("action/action_0")[:, 0], run.column("outcome/sensor_2")[:, 0]
    angle = np.arctan2(sin, cos)
    for _ in range(2):  # Pendulum-v1's own physics, twice with the same torque
        speed = np.clip(speed + 0.05 * (15.0 * np.sin(angle) + 3.0 * torque), -8, 8)
        angle = angle + 0.05 * speed
    assert next_speed == pytest.approx(speed, abs=1e-3)
    typed("resume", tmp_path / "a", "--steps", "40")
    whole = train(tmp_path / "whole", *words, steps=40)
    assert load_run(tmp_path / "a").steps == whole.steps


def test_a_comparison_may_be_about_a_public_world(tmp_path: Path) -> None:
    variants = ["--variant", "progress:", "--variant", "random: --drive random"]
    common = ["--", "--world", "Pendulum-v1", "--steps", "30", *SPLITTING]
    numbers = ["--seeds", "2", "--processes", "1"]
    answer = typed("compare", tmp_path / "a", *variants, *numbers, *common)
    assert answer.code == 0, answer.err
    assert answer.out.startswith("4 runs: 4 done.")


def test_a_world_of_ones_own_is_found_in_its_module(
    custom: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    words = ["--world", custom, "--world-options", "loudness=10", *SPLITTING]
    with caplog.at_level(logging.INFO):
        run = train(tmp_path / "a", *words, "--bounds-from", "200", steps=60)
    assert caplog.messages == ["Bounds for 1 of 1 sensors were found in 200 random decisions"]
    assert run.config["bounds"] == {"given": [], "found": ["echo"]}
    (echo,) = run.space.sensors
    assert (echo.low, echo.high) == pytest.approx((-12, 12), abs=0.5)
    assert (run.column("outcome/echo") == 10 * run.column("action/push")).all()


def test_given_bounds_clip_and_the_report_says_how_often(custom: str, tmp_path: Path) -> None:
    words = ["--world", custom, "--sensor-bounds", "echo=-0.5,0.5", *SPLITTING]
    answer = typed("train", "--steps", "200", "--out", tmp_path / "a", *words)
    assert answer.code == 0, answer.err
    run = load_run(tmp_path / "a")
    assert run.config["bounds"] == {"given": ["echo"], "found": []}
    pushes = run.column("action/push")
    assert (run.column("outcome/echo") == np.clip(pushes, -0.5, 0.5)).all()
    said = re.search(r"At their bounds or beyond: echo (\d+)%; see --sensor-bounds\.", answer.out)
    assert said
    assert int(said[1]) == pytest.approx(100 * (abs(pushes[:-1]) >= 0.5).mean(), abs=1)


def test_a_world_that_cannot_begin_leaves_no_run(custom: str, tmp_path: Path) -> None:
    words = ["--world", custom, "--world-options", "fails=true", "--out", str(tmp_path / "a")]
    with pytest.raises(RuntimeError, match="the world cannot begin"):
        typed("train", *words)
    assert not (tmp_path / "a").exists()


def test_an_option_that_a_world_breaks_on_is_named(custom: str, tmp_path: Path) -> None:
    words = ["--world", custom, "--world-options", "loudness=2", "parts=0"]
    answer = typed("train", "--out", tmp_path / "a", *words)
    said = "ZeroDivisionError('division by zero')"
    assert answer.code == 2
    assert answer.err == f"torch-iac: {custom} cannot be made with loudness=2 parts=0: {said}\n"
    assert not (tmp_path / "a").exists()


def test_a_world_that_breaks_without_options_shows_where(custom: str, tmp_path: Path) -> None:
    module = tmp_path / "user" / "custom_echo_world.py"
    module.write_text(CUSTOM.replace("parts: int = 1", "parts: int = 0"))
    with pytest.raises(ZeroDivisionError):
        typed("train", "--world", custom, "--out", tmp_path / "a")


def test_a_run_is_named_by_the_time_and_its_world(
    custom: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert typed("train", "--steps", "5", "--world", custom).code == 0
    (folder,) = (tmp_path / "runs").iterdir()
    assert re.fullmatch(r"\d{8}-\d{6}-custom_echo_world-custom-Echo-v0", folder.name)


FORGETFUL = """
import gymnasium as gym
import numpy as np

class Forgetful(gym.Env):
    def __init__(self) -> None:
        self.action_space = gym.spaces.Discrete(3)
        self.observation_space = gym.spaces.Box(0.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        self.np_random = np.random.default_rng(seed)
        return self.np_random.random(1, np.float32), {}

    def step(self, action):
        return self.np_random.random(1, np.float32), 0.0, False, False, {}

gym.register("custom/Forgetful-v0", Forgetful, max_episode_steps=5)
"""


def test_where_episodes_would_begin_by_chance_they_are_seeded(custom: str, tmp_path: Path) -> None:
    module = custom.partition(":")[0]
    (tmp_path / "user" / f"{module}.py").write_text(FORGETFUL)
    world = ["--world", f"{module}:custom/Forgetful-v0"]
    whole = train(tmp_path / "whole", *world, *SPLITTING, steps=30)
    train(tmp_path / "a", *world, *SPLITTING, steps=13)
    answer = typed("resume", tmp_path / "a", "--steps", "30")
    assert (answer.code, answer.err) == (0, "")
    assert load_run(tmp_path / "a").steps == whole.steps
    begun = whole.column("sensor/sensor_0")[::5, 0]
    assert len(set(begun)) == len(begun)  # not all alike


@needs_mujoco
def test_robots_in_mujoco_live_as_each_would_alone(tmp_path: Path) -> None:
    words = ["--world", "Reacher-v5", *SPLITTING]
    together = train(tmp_path / "both", "--agents", "2", "--seed", "7", *words, steps=60)
    assert len(together.config["bounds"]["found"]) == 10
    for agent, seed in enumerate(together.seeds):
        alone = train(tmp_path / str(seed), "--seed", str(seed), *words, steps=60)
        assert alone.space == together.space  # bounds are the world's, not the robot's
        assert together.table(agent=agent).drop("agent") == alone.steps.drop("agent")


@needs_mujoco
def test_a_run_in_mujoco_goes_on_as_if_it_had_never_ended(tmp_path: Path) -> None:
    words = ["--world", "Hopper-v5", *SPLITTING]
    whole = train(tmp_path / "whole", *words, steps=60)
    train(tmp_path / "a", *words, steps=35)
    assert typed("resume", tmp_path / "a", "--steps", "60").code == 0
    assert pa.Table.equals(load_run(tmp_path / "a").steps, whole.steps)


KINDS = "toyroom, kinematic or a world of Gymnasium such as Pendulum-v1"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--world mars", f"world must be {KINDS}, got mars (Environment `mars` doesn't exist.)"),
        ("--world mars:Sol-v1", f"world must be {KINDS}, got mars:Sol-v1 (No module named 'mars')"),
        ("--encoder eye", "encoder must be convolution, pixels or module:Name, got eye"),
        (
            "--world Pendulum-v1 --world-options smell=1",
            "options of Pendulum-v1 must be among render_mode, g, max_episode_steps, got smell",
        ),
        (
            "--world Pendulum-v1 --world-options g=heavy",
            "g must be a number, got heavy",
        ),
        (
            "--world Pendulum-v1 --world-options max_episode_steps=ten",
            "max_episode_steps must be a whole number, got ten",
        ),
        (
            "--world Pendulum-v1 --outcomes speed",
            "outcomes must be sensors (sensor_0, sensor_1, sensor_2), got speed",
        ),
        (
            "--world Pendulum-v1 --sensor-bounds speed=0,1",
            "sensor bounds must be of sensor_0, sensor_1, sensor_2, got speed",
        ),
        (
            "--world kinematic --sensor-bounds toy_distance=0,1",
            "sensor_bounds must be left to worlds that are single, got ToyRoomKinematic",
        ),
        (
            "--world kinematic --hold 2",
            "hold must be left to worlds that are single, got kinematic",
        ),
        ("--hold 0", "hold must lie in [1, 1,000], got 0"),
        (
            "--bounds-from 0",
            "bounds_from must lie in [1, 1,000,000], got 0",
        ),
    ],
)
def test_what_cannot_be_is_answered_with_one_sentence(
    tmp_path: Path, words: str, sentence: str
) -> None:
    answer = typed("train", "--out", tmp_path / "a", *words.split())
    assert (answer.code, answer.out, answer.err) == (2, "", f"torch-iac: {sentence}\n")
    assert not (tmp_path / "a").exists()
