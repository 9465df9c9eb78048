"""Does the toy room hold for long? Its physical state, its speed and its memory, watched.

    python -m scripts.stress.world_soak

takes random decisions and stops at the first one after which the robot has fallen over,
robot or toy is not in the room, or a number is none; else prints the extremes that were seen.
"""

import resource
import time
from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac_envs.room import Room
from torch_iac_envs.toy_room import ToyRoom

TILT_LIMIT = 0.05  # rad
HEIGHT_LIMIT = 0.02  # m that robot or toy may leave the height at which it rests


@dataclass(frozen=True)
class Study:
    """What is watched."""

    decisions: int = 100_000
    """How many random decisions are taken."""
    seed: int = 0
    """Seeds the world and the decisions."""
    report_every: int = 10_000
    """Decisions between two lines of the report."""


@dataclass
class Extremes:
    """The largest values seen so far.

    Attributes:
        tilt: Angle between the robot's axis and the vertical (rad).
        robot: Distance of the robot's centre from the room's middle, along x or y (m).
        toy: The same of the toy's centre (m).
        lift: Distance of robot or toy from the height at which it rests (m).
    """

    tilt: float = 0.0
    robot: float = 0.0
    toy: float = 0.0
    lift: float = 0.0
    room: Room = field(default_factory=Room)

    def see(self, state: NDArray[np.float64]) -> None:
        """Take in one physical state, shape `(30,)`.

        Raises:
            RuntimeError: The state is not one of a robot on its wheels and a toy in a room.
        """
        if not np.isfinite(state).all():
            raise RuntimeError("a physical state must be finite, got one that is not")
        rest = np.array([self.room.wheel_radius, self.room.toy_radius])
        self.tilt = max(self.tilt, float(2 * np.linalg.norm(state[3:5])))
        self.robot = max(self.robot, float(np.abs(state[:2]).max()))
        self.toy = max(self.toy, float(np.abs(state[17:19]).max()))
        self.lift = max(self.lift, float(np.abs(state[[2, 19]] - rest).max()))
        self._check()

    def _check(self) -> None:
        half = self.room.side / 2
        for name, value, limit in (
            ("tilt", self.tilt, TILT_LIMIT),
            ("robot", self.robot, half),
            ("toy", self.toy, half),
            ("lift", self.lift, HEIGHT_LIMIT),
        ):
            if value > limit:
                raise RuntimeError(f"{name} must be at most {limit}, got {value}")


def main(study: Study) -> None:
    """Take random decisions and report."""
    env = gym.make("torch_iac_envs/ToyRoom-v0", disable_env_checker=True)
    world = env.unwrapped
    assert isinstance(world, ToyRoom)
    env.reset(seed=study.seed)
    env.action_space.seed(study.seed)
    extremes, start = Extremes(), time.perf_counter()
    print("| decisions | tilt (rad) | robot (m) | toy (m) | lift (m) | memory (MiB) | a second |")
    print("|---" * 7 + "|")
    for decision in range(1, study.decisions + 1):
        env.step(env.action_space.sample())
        extremes.see(world.get_state()["present"])
        if decision % study.report_every == 0:
            speed = decision / (time.perf_counter() - start)
            print(f"| {decision} {_cells(extremes)} | {_memory():.1f} | {speed:.0f} |", flush=True)
    env.close()


def _cells(seen: Extremes) -> str:
    return f"| {seen.tilt:.4f} | {seen.robot:.3f} | {seen.toy:.3f} | {seen.lift:.4f}"


def _memory() -> float:
    """Return the most memory that the process has held so far (MiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
