"""How long decisions take: one robot beside the plain-Python oracle, and populations.

    python -m scripts.benchmark

One robot of each kind of expert develops in the toy room on one thread; the oracle,
`tests/oracle.py`, then lives through the decisions of the first, with the same examples. Then
populations decide on made-up sensors, on all threads; their networks are held against the time that
their multiplications alone would take at the speed of a large matrix product on this machine.
Prints Markdown; `docs/benchmarks.md` holds a copy.
"""

import os
import platform
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from random import random

import gymnasium as gym
import numpy as np
import torch
import tyro
from torch import Tensor, nn

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from tests.agreement import oracle_of, scaled
from tests.oracle import Robot

WORLD = "torch_iac_envs/ToyRoom-v0"


class Waves(nn.Module):
    """A module that is no plain sequence of layers."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(n_inputs, 32), nn.Linear(32, 32)
        self.last = nn.Linear(32, n_outputs)

    def forward(self, situations: Tensor) -> Tensor:
        """Return outcomes."""
        outcomes: Tensor = self.last(self.second(self.first(situations).sin()).relu())
        return outcomes


ROBOTS = {
    "nearest neighbour": iac.IACConfig(),
    "nearest neighbour, with MP": iac.IACConfig(meta=iac.MetaPredictor()),
    "MLP": iac.IACConfig(experts=iac.MLPExperts()),
    "any module": iac.IACConfig(experts=iac.NetworkExperts(module=Waves)),
}

POPULATIONS: dict[str, tuple[int, iac.Experts]] = {
    "nearest neighbour": (512, iac.KNNExperts()),
    "MLP": (256, iac.MLPExperts()),
}


@dataclass(frozen=True)
class Benchmark:
    """How much is measured."""

    steps: int = 10_000
    """How many decisions the robot with nearest neighbours takes."""
    short_steps: int = 2_000
    """How many decisions the other robots take."""
    population_steps: int = 600
    """How many decisions a population takes."""
    counted: int = 500
    """Over how many of the last decisions of one robot times are taken."""
    seed: int = 0
    """Seed of the robots."""


class Stopwatch:
    """Seconds that each part of a decision took."""

    def __init__(self) -> None:
        self._seconds: defaultdict[str, list[float]] = defaultdict(list)

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Time a block."""
        started = time.perf_counter()
        yield
        self._seconds[part].append(time.perf_counter() - started)

    def last(self, n: int, *parts: str) -> np.ndarray:
        """Return the last `n` times of some parts together, in milliseconds."""
        times: np.ndarray = np.sum([self._seconds[part][-n:] for part in parts], axis=0)
        return 1000 * times


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    print(f"{platform.machine()}, {cpu_model()}, {os.cpu_count()} cores, torch {torch.__version__}")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    print("\n| one robot, one thread | decisions | median ms | mean ms |\n|---|---|---|---|")
    for i, (name, config) in enumerate(ROBOTS.items()):
        measure_robot(name, config, benchmark, with_oracle=i == 0)
    torch.set_num_threads(threads)
    print(f"\n| population, {threads} threads | agents | agent-decisions a second | of the floor |")
    print("|---|---|---|---|")
    for name, (n_agents, experts) in POPULATIONS.items():
        measure_population(name, n_agents, experts, benchmark)


def measure_robot(
    name: str, config: iac.IACConfig, benchmark: Benchmark, with_oracle: bool
) -> None:
    """Let one robot develop and print how long its last decisions took."""
    env = gym.make_vec(WORLD, num_envs=1)
    space = iac.SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    agent = iac.IAC(space, config, seeds=[benchmark.seed])
    stopwatch, steps = Stopwatch(), []
    n_decisions = benchmark.steps if with_oracle else benchmark.short_steps
    sensors, _ = env.reset(seed=benchmark.seed)
    for _ in range(n_decisions):
        with stopwatch("act"):
            actions = agent.act(sensors)
        with stopwatch("world"):
            sensors, *_ = env.step(actions)
        with stopwatch("observe"):
            steps.append(agent.observe(sensors))
    env.close()
    if with_oracle:
        live_again(iac.IAC(space, config, seeds=[benchmark.seed]), steps, stopwatch)
        follow(oracle_of(config), space, steps, config.n_candidates, stopwatch)
    rows: dict[str, tuple[str, ...]] = {f"{name}: act and observe": ("act", "observe")}
    if with_oracle:
        rows |= {f"{name}: the same without physics in between": ("again",)}
        rows |= {f"{name}: the oracle": ("oracle",), "the toy room": ("world",)}
    for row, parts in rows.items():
        times = stopwatch.last(benchmark.counted, *parts)
        print(f"| {row} | {n_decisions:,} | {np.median(times):.3f} | {times.mean():.3f} |")


def live_again(agent: iac.IAC, steps: Sequence[iac.Step], stopwatch: Stopwatch) -> None:
    """Let a robot of the same seed sense the same, and so do the same, with nothing in between."""
    before = [step.sensors.numpy() for step in steps]
    for sensors, after in pairwise(before):
        with stopwatch("again"):
            agent.act(sensors)
            agent.observe(after)


def follow(
    robot: Robot,
    space: iac.SensorimotorSpace,
    steps: Sequence[iac.Step],
    n_candidates: int,
    stopwatch: Stopwatch,
) -> None:
    """Let the oracle decide among as many candidates, then learn from what the robot did."""
    for step in steps:
        context = scaled(space.sensors, step.sensors)
        situation = scaled(space.actions, step.actions) + context
        outcome = scaled(space.outcomes, step.outcomes)
        with stopwatch("oracle"):
            actions = [[random() for _ in space.actions] for _ in range(n_candidates)]
            robot.choose([action + context for action in actions])
            robot.observe(situation, outcome)


def measure_population(
    name: str, n_agents: int, experts: iac.Experts, benchmark: Benchmark
) -> None:
    """Let a population decide on made-up sensors and print how many decisions it takes."""
    wires = tuple(iac.Dimension(f"s{i}", 0.0, 1.0) for i in range(11))
    actions = tuple(iac.Dimension(f"a{i}", 0.0, 1.0) for i in range(3))
    space = iac.SensorimotorSpace(actions, wires, wires[:1])
    agent = iac.IAC(space, replace(iac.IACConfig(), experts=experts), range(n_agents))
    stopwatch = Stopwatch()
    sensors = torch.rand(n_agents, len(wires))
    for _ in range(benchmark.population_steps):
        with stopwatch("act"):
            chosen = agent.act(sensors)
        sensors = torch.rand(n_agents, len(wires))
        sensors[:, 0] = torch.where(chosen[:, 2] > 2 / 3, 0.0, (chosen[:, 0] + sensors[:, 1]) / 2)
        with stopwatch("observe"):
            agent.observe(sensors)
    times = stopwatch.last(benchmark.population_steps // 2, "act", "observe")
    floor = (
        "" if isinstance(experts, iac.KNNExperts) else f"{floor_ms(n_agents) / times.mean():.0%}"
    )
    print(f"| {name} | {n_agents} | {1000 * n_agents / times.mean():,.0f} | {floor} |")


def floor_ms(n_agents: int) -> float:
    """Return how long the default MLP's multiplications take at the speed of a large product."""
    n_weights = 14 * 32 + 32 * 32 + 32
    samples = n_agents * 4 * 32
    operations = 3 * 2 * n_weights * samples  # forwards once, backwards twice as much
    size = 1024
    matrix = torch.rand(size, size)
    times = []
    for _ in range(20):
        started = time.perf_counter()
        matrix @ matrix
        times.append(time.perf_counter() - started)
    return 1000 * operations / (2 * size**3 / float(np.median(times)))


def cpu_model() -> str:
    """Return what the processor calls itself."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(": ")[1] for line in lines if line.startswith("model name")), "?")


if __name__ == "__main__":
    main(tyro.cli(Benchmark, description=__doc__))
