"""Films of worlds that are not the library's own."""

from pathlib import Path
from typing import Any, ClassVar, SupportsFloat

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from tests.cli.test_cli import typed
from torch_iac import Experiment
from torch_iac.cli.exits import one_line


class Wide(gym.Env[NDArray[np.float64], NDArray[np.float32]]):
    """A world whose sensors are float64, and go beyond what they are clipped to."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 2}  # type: ignore[misc]
    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
    observation_space = gym.spaces.Box(-np.inf, np.inf, (1,), np.float64)

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return self.np_random.normal(size=1), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], SupportsFloat, bool, bool, dict[str, Any]]:
        return self.np_random.normal(size=1) + action, 0.0, False, False, {}

    def render(self) -> NDArray[np.uint8]:
        return np.zeros((8, 8, 3), np.uint8)


def test_worlds_of_float64_and_clipped_sensors_come_out_as_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gym.envs.registration, "registry", {})
    gym.register("Wide-v0", entry_point=Wide)  # type: ignore[arg-type]
    experiment = Experiment(world="Wide-v0", sensor_bounds={"sensor_0": (-0.5, 0.5)}, steps=12)
    experiment.run(tmp_path / "a")
    answer = typed("replay", tmp_path / "a", "--decisions", "2", "--out", tmp_path / "a.gif")
    assert (answer.code, answer.out) == (0, f"{tmp_path / 'a.gif'}\n")


def test_what_mujoco_needs_is_said_with_the_librarys_own_name() -> None:
    error = DependencyNotInstalled('MuJoCo is not installed, run `pip install "gymnasium[mujoco]"`')
    assert one_line(error).endswith(", or pip install 'torch_iac[mujoco]'")
    assert "mujoco" not in one_line(ValueError("pygame is not installed"))
