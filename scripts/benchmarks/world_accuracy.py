"""How accurate and how fast is the toy room? Its robot against itself with a finer time step.

    python -m scripts.benchmarks.world_accuracy

lets the robot take random decisions from the same poses twice, the second time with a quarter of
the time step, without noise, and prints how far apart it ends; then how many decisions a second
the world takes with its default noise and sensors, on one core.
"""

import math
import time
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac_envs.physics import Command, Physics, resting_state
from torch_iac_envs.room import Room

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Study:
    """What is compared."""

    decisions: int = 4_000
    """How many random decisions are taken, each from a random pose."""
    substeps: int = 8
    """Physics steps in a tenth of a second, of the world that is judged."""
    seed: int = 0
    """Draws the poses and the decisions."""
    repeats: int = 9
    """How often 1,000 decisions are timed; the median is printed."""


@dataclass(frozen=True)
class Difference:
    """How far apart two robots end, on average over the decisions.

    Attributes:
        displacement: Distance between their ends, as a share of the distance covered.
        heading: Angle between their headings (rad).
    """

    displacement: float
    heading: float


def compare(n_decisions: int, substeps: int, seed: int) -> Difference:
    """Return how far the robot is from one simulated with a quarter of the time step."""
    draw = np.random.default_rng(seed)
    reach = Room().robot_reach
    starts = draw.uniform((-reach, -reach, -math.pi), (reach, reach, math.pi), (n_decisions, 3))
    wheels = draw.uniform(-1, 1, (n_decisions, 2))
    coarse, fine = (_ends(starts, wheels, steps) for steps in (substeps, 4 * substeps))
    apart = np.linalg.norm(coarse[:, :2] - fine[:, :2], axis=1).mean()
    covered = np.linalg.norm(fine[:, :2] - starts[:, :2], axis=1).mean()
    turned = np.angle(np.exp(1j * (coarse[:, 2] - fine[:, 2])))
    return Difference(float(apart / covered), float(np.abs(turned).mean()))


def _ends(starts: Array, wheels: Array, substeps: int) -> Array:
    """Return where each decision leads, shape `(decisions, 3)`: x, y and heading."""
    room = Room()
    physics = Physics(room, 0, substeps)
    ends = np.empty_like(starts)
    for row, ((x, y, heading), (left, right)) in enumerate(zip(starts, wheels, strict=True)):
        physics.seat(resting_state(room, (x, y), heading, (0.0, 0.0)))
        physics.advance(Command(left, right))
        ends[row] = physics.robot_pose()
    physics.close()
    return ends


def decisions_per_second(repeats: int) -> float:
    """Return the median speed of the world with its default arguments."""
    env = gym.make("torch_iac_envs/ToyRoom-v0", disable_env_checker=True)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(1_000)]
    speeds = [_time(env, actions) for _ in range(repeats)]
    env.close()
    return float(np.median(speeds))


def _time(env: gym.Env[Array, Array], actions: list[Array]) -> float:
    start = time.perf_counter()
    for action in actions:
        env.step(action)
    return len(actions) / (time.perf_counter() - start)


def main(study: Study) -> None:
    """Print what was found."""
    difference = compare(study.decisions, study.substeps, study.seed)
    print(f"displacement: {difference.displacement:.2%} from that at a quarter of the time step")
    print(f"heading: {difference.heading:.4f} rad from that at a quarter of the time step")
    print(f"speed: {decisions_per_second(study.repeats):.0f} decisions a second")


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
