"""How long a decision of one robot takes on one core, beside the plain-Python oracle.

    python -m scripts.benchmark

The robot develops in the toy room; the oracle, `tests/oracle.py`, lives through the same last
decisions, with the same examples. A table in Markdown gives the median and the mean of each part.
"""

import platform
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import random

import gymnasium as gym
import numpy as np
import torch
import tyro

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from tests.agreement import oracle_of, scaled
from tests.oracle import Robot

WORLD = "torch_iac_envs/ToyRoom-v0"


@dataclass(frozen=True)
class Benchmark:
    """How much is measured."""

    steps: int = 10_000
    """How many decisions the robot takes."""
    counted: int = 1_000
    """Over how many of the last decisions times are taken."""
    seed: int = 0
    """Seed of the robot."""


class Stopwatch:
    """Seconds that each part of a decision took, for the decisions that count."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, list[float]] = defaultdict(list)

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Time a block."""
        started = time.perf_counter()
        yield
        self.seconds[part].append(time.perf_counter() - started)

    def last(self, part: str, n: int) -> np.ndarray:
        """Return the last `n` times of a part, in milliseconds."""
        return 1000 * np.array(self.seconds[part][-n:])


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    stopwatch = Stopwatch()
    agent = measure_robot(benchmark, stopwatch)
    n = benchmark.counted
    parts = {
        "agent: act": stopwatch.last("act", n),
        "agent: observe": stopwatch.last("observe", n),
        "agent, together": stopwatch.last("act", n) + stopwatch.last("observe", n),
        "world": stopwatch.last("world", n),
        "oracle, together": stopwatch.last("oracle", n),
    }
    print(f"{platform.machine()}, {cpu_model()}, one thread, torch {torch.__version__}")
    print(f"decisions {benchmark.steps - n + 1:,} to {benchmark.steps:,}, seed {benchmark.seed}, ")
    print(f"{agent.tree.n_rows} leaves, {int(agent.tree.depth.max())} cuts deep\n")
    print("| part | median ms | mean ms |\n|---|---|---|")
    for part, times in parts.items():
        print(f"| {part} | {np.median(times):.3f} | {times.mean():.3f} |")
    ratio = np.median(parts["oracle, together"]) / np.median(parts["agent, together"])
    print(f"\nThe agent is {ratio:.1f} times as fast as the oracle.")


def measure_robot(benchmark: Benchmark, stopwatch: Stopwatch) -> iac.IAC:
    """Let one robot develop; the oracle follows and, at the end, is timed too."""
    env = gym.make_vec(WORLD, num_envs=1)
    space = iac.SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    agent = iac.IAC(space, seeds=[benchmark.seed])
    robot = oracle_of(agent.config)
    sensors, _ = env.reset(seed=benchmark.seed)
    for _ in range(benchmark.steps):
        with stopwatch("act"):
            actions = agent.act(sensors)
        with stopwatch("world"):
            sensors, *_ = env.step(actions)
        with stopwatch("observe"):
            step = agent.observe(sensors)
        follow(robot, space, step, agent.config.n_candidates, stopwatch)
    env.close()
    return agent


def follow(
    robot: Robot,
    space: iac.SensorimotorSpace,
    step: iac.Step,
    n_candidates: int,
    stopwatch: Stopwatch,
) -> None:
    """Let the oracle decide among as many candidates, then learn from what the robot did."""
    context = scaled(space.sensors, step.sensors)
    situation = scaled(space.actions, step.actions) + context
    outcome = scaled(space.outcomes, step.outcomes)
    with stopwatch("oracle"):
        actions = [[random() for _ in space.actions] for _ in range(n_candidates)]
        robot.choose([action + context for action in actions])
        robot.observe(situation, outcome)


def cpu_model() -> str:
    """Return what the processor calls itself."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(": ")[1] for line in lines if line.startswith("model name")), "?")


if __name__ == "__main__":
    main(tyro.cli(Benchmark, description=__doc__))
