"""Other people's worlds, through the ordinary command: lived in, gone on with, and drawn."""

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.cli.test_cli import train, typed
from torch_iac import Experiment, IACConfig, ProgressReward, VectorProgressReward
from torch_iac.runs.reader import Run, load_run
from torch_iac.worlds.make import SeededEpisodes

SPLITTING = ["--max-examples=20", "--window=8", "--delay=8", "--n-candidates=5", "--no-mp"]
SMALL = IACConfig(n_candidates=5, max_examples=20, window=8, delay=8, meta=None)
"""Regions split often, so that a short run shows much."""

ROOMS = "minigrid:MiniGrid-MultiRoom-N2-S4-v0"

# What these packages say of themselves is not ours.
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*:DeprecationWarning:pygame"),
    pytest.mark.filterwarnings("ignore:.*:DeprecationWarning:pkg_resources"),
]


def needs(package: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(not find_spec(package), reason=f"needs {package} (extra worlds)")


WORLDS = [
    pytest.param(["CartPole-v1"], id="CartPole"),
    pytest.param(["FrozenLake-v1"], id="FrozenLake"),
    pytest.param(["Blackjack-v1"], id="Blackjack"),
    pytest.param([ROOMS], id="MiniGrid", marks=needs("minigrid")),
    pytest.param(
        ["minigrid:MiniGrid-KeyCorridorS3R1-v0", "--encoder", "pixels"],
        id="MiniGrid pixels",
        marks=needs("minigrid"),
    ),
    pytest.param(
        ["gymnasium_robotics:PointMaze_UMaze-v3", "--hold", "5"],
        id="PointMaze",
        marks=needs("gymnasium_robotics"),
    ),
    pytest.param(["panda_gym:PandaReach-v3"], id="Panda", marks=needs("panda_gym")),
    pytest.param(["ale_py:ALE/Pong-v5"], id="Atari", marks=needs("ale_py")),
]


def import_world(name: str) -> None:
    """Import a world's package, some of which then print something."""
    if ":" in name:
        import_module(name.partition(":")[0])


@pytest.mark.parametrize("world", WORLDS)
def test_a_world_is_lived_in_gone_on_with_bit_for_bit_and_drawn(
    world: list[str], tmp_path: Path
) -> None:
    import_world(world[0])
    words = ["--world", *world, "--bounds-from", "50", "--agents", "2", *SPLITTING]
    whole = train(tmp_path / "whole", *words, steps=60)
    train(tmp_path / "a", *words, steps=35)
    answer = typed("resume", tmp_path / "a", "--steps", "60")
    assert (answer.code, answer.err) == (0, "")
    run = load_run(tmp_path / "a")
    assert run.steps == whole.steps
    assert run.regions == whole.regions
    assert len(run.regions) > 2
    assert (run.folder / "figures" / "experts.png").stat().st_size
    for action in run.space.actions:
        if action.n_values is not None:
            done = set(run.column(f"action/{action.name}").ravel().tolist())
            values = np.linspace(action.low, action.high, action.n_values)
            assert len(done) > 1
            assert done <= set(values.tolist())


FETCH = """
from torch_iac.cli.main import main
words = "--world gymnasium_robotics:FetchReach-v4 --bounds-from 20 --no-mp".split()
main(["train", *words, "--steps", "20", "--out", "whole"])
main(["train", *words, "--steps", "10", "--out", "a"])
main(["resume", "a", "--steps", "20"])
"""


@needs("gymnasium_robotics")
def test_fetch_is_lived_in_without_the_assertion_that_fails_with_mujoco_of_today(
    tmp_path: Path,
) -> None:
    subprocess.run([sys.executable, "-O", "-c", FETCH], cwd=tmp_path, check=True)
    run = load_run(tmp_path / "a")
    assert run.steps == load_run(tmp_path / "whole").steps
    assert len(run.space.actions) == 4
    assert {"achieved_goal/0", "desired_goal/2", "observation/9"} < {
        sensor.name for sensor in run.space.sensors
    }


def test_a_lake_is_what_its_rules_say(tmp_path: Path) -> None:
    words = ["--world", "FrozenLake-v1", "--world-options", "is_slippery=false"]
    run = train(tmp_path / "a", *words, *SPLITTING, steps=200)
    names = [sensor.name for sensor in run.space.sensors]
    before, after = (
        run.columns(f"{kind}/{name}" for name in names)[:, 0].argmax(axis=1)
        for kind in ("sensor", "outcome")
    )
    left, down, right, up = (0, -1), (1, 0), (0, 1), (-1, 0)
    moves = np.array([left, down, right, up])[run.column("action/action_0")[:, 0].astype(int)]
    places = np.stack([before // 4, before % 4], axis=1) + moves
    rows, columns = places.clip(0, 3).T
    assert (after == 4 * rows + columns).all()


@needs("minigrid")
def test_what_the_robot_does_not_sense_is_said_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level("INFO"):
        run = train(tmp_path / "a", "--world", ROOMS, "--bounds-from=20", *SPLITTING, steps=30)
        assert typed("resume", run.folder, "--steps", "40").code == 0
    assert caplog.messages.count("The robot does not sense mission, which is text") == 1
    assert run.config["encoder"] == "convolution"


@needs("minigrid")
def test_what_was_sensed_of_pictures_and_clipped_is_filmed(tmp_path: Path) -> None:
    words = ["--world", ROOMS, "--bounds-from=5", *SPLITTING]
    run = train(tmp_path / "a", *words, steps=60)  # beyond the first episode, of 40 steps
    sensed = run.columns(f"sensor/{sensor.name}" for sensor in run.space.sensors)[:, 0]
    highs = np.array([sensor.high for sensor in run.space.sensors[4:]], np.float32)
    assert (sensed[:, 4:] == highs).any()
    answer = typed("replay", run.folder, "--at=50", "--decisions=1", "--out", tmp_path / "a.gif")
    assert (answer.code, answer.err) == (0, "")


@needs("minigrid")
def test_a_comparison_may_be_about_an_encoder(tmp_path: Path) -> None:
    variants = ["--variant", "features:", "--variant", "pixels: --encoder pixels"]
    common = ["--", "--world", ROOMS, "--steps", "30", "--bounds-from", "20", *SPLITTING]
    answer = typed("compare", tmp_path / "a", *variants, "--seeds=1", "--processes=1", *common)
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.startswith("2 runs: 2 done.")


EYE = """
import torch

class Eye(torch.nn.Module):
    def forward(self, pictures):
        return pictures.mean(dim=(2, 3)) * 255
"""


@needs("minigrid")
def test_an_encoder_of_ones_own_is_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_eye.py").write_text(EYE)
    monkeypatch.chdir(tmp_path)
    words = ["--world", ROOMS, "--encoder", "own_eye:Eye", "--bounds-from=50", *SPLITTING]
    train(tmp_path / "a", *words, steps=30)
    assert typed("resume", "a", "--steps", "40").code == 0
    run = load_run("a")
    assert run.config["encoder"] == "own_eye:Eye"
    names = [f"image/feature_{i}" for i in range(3)]
    assert [sensor.name for sensor in run.space.sensors if sensor.name in names] == names
    (tmp_path / "own_eye.py").write_text(EYE.replace("255", "5"))
    monkeypatch.delitem(sys.modules, "own_eye")
    answer = typed("resume", "a", "--steps", "50")
    assert answer.code == 2
    assert "a world must repeat itself to be gone on with" in answer.err


# Learning progress as the reward of a learner, who acts in the world as it is.


def rewarded(run: Run, env: ProgressReward) -> None:
    """Check that a learner who does what a robot did teaches the experts what it learnt."""
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    errors, discrete = run.column("error")[:, 0], isinstance(env.action_space, gym.spaces.Discrete)
    done = run.columns(f"action/{action.name}" for action in run.space.actions)[:, 0]
    for number in range(run.n_decisions):
        action = int(done[number, 0]) if discrete else done[number].astype(np.float32)
        observation, _, terminated, truncated, info = env.step(action)
        assert observation in env.observation_space
        assert info["iac"]["error"] == pytest.approx(errors[number], abs=1e-9)
        if terminated or truncated:
            env.reset()


@pytest.mark.parametrize(
    ("world", "encoder"),
    [
        pytest.param("CartPole-v1", "convolution", id="CartPole"),
        pytest.param("FrozenLake-v1", "convolution", id="FrozenLake"),
        pytest.param(ROOMS, "convolution", id="MiniGrid", marks=needs("minigrid")),
        pytest.param(ROOMS, "pixels", id="MiniGrid pixels", marks=needs("minigrid")),
    ],
)
def test_experts_who_look_on_see_what_robots_see(world: str, encoder: str, tmp_path: Path) -> None:
    """With the same seed, and the bounds that are found for both alike."""
    experiment = Experiment(
        world=world, encoder=encoder, steps=60, bounds_from=100, config=SMALL, seeds=[0]
    )
    run = experiment.run(tmp_path / "a")
    env = SeededEpisodes(gym.make(world))
    reward = ProgressReward(env, SMALL, seed=0, encoder=encoder, bounds_from=100)
    assert reward.action_space is env.action_space
    assert reward.observation_space is env.observation_space
    assert reward.agent.space == run.space
    rewarded(run, reward)


@pytest.mark.parametrize(
    "world",
    [
        "CartPole-v1",
        "Blackjack-v1",
        pytest.param(ROOMS, marks=needs("minigrid")),
        pytest.param("gymnasium_robotics:PointMaze_UMaze-v3", marks=needs("gymnasium_robotics")),
    ],
)
@pytest.mark.parametrize("kind", ["sync", "async"])
def test_a_vector_of_worlds_is_seen_as_each_alone(world: str, kind: str) -> None:
    import_world(world)
    mode: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    if kind == "async":
        mode["shared_memory"] = world != ROOMS  # Gymnasium cannot share MiniGrid's texts
    worlds = gym.make_vec(world, 2, kind, vector_kwargs=mode, max_episode_steps=7)
    both = VectorProgressReward(worlds, SMALL, seeds=[3, 4], bounds_from=50)
    alone = ProgressReward(gym.make(world, max_episode_steps=7), SMALL, seed=4, bounds_from=50)
    assert both.agent.space == alone.agent.space
    both.action_space.seed(0)
    alone.reset(seed=4)
    observations, _ = both.reset(seed=[3, 4])
    assert observations in both.observation_space
    each = gym.vector.utils.iterate
    for _ in range(20):
        actions = both.action_space.sample()
        _, rewards, terminated, truncated, info = both.step(actions)
        action: Any = list(each(both.action_space, actions))[1]
        _, reward, *is_over, told = alone.step(action)
        assert rewards[1] == reward
        assert info["iac"]["error"][1] == told["iac"]["error"]
        assert (terminated | truncated)[1] == any(is_over)
        if any(is_over):
            alone.reset()
    both.close()


def test_a_world_that_cannot_be_made_once_more_needs_bounds() -> None:
    env = gym.make("CartPole-v1").unwrapped
    env.spec = None
    with pytest.raises(ValueError, match=r"^sensor_bounds must be given for all sensors without"):
        ProgressReward(env, SMALL)
    given = {"sensor_1": (-0.5, 0.5), "sensor_3": (-3.0, 3.0)}
    reward = ProgressReward(env, SMALL, sensor_bounds=given)
    reward.reset(seed=0)
    for _ in range(5):  # pushed ever further, the cart is faster than the bound
        observation, *_ = reward.step(1)
    assert reward.last is not None
    assert observation[1] > reward.last.outcomes[0, 1] == 0.5
