"""How long decisions take: one robot beside the plain-Python oracle, and populations.

    python -m scripts.benchmarks.benchmark

One robot of each kind of expert develops in the toy room on one thread; the oracle,
`tests/oracle.py`, then takes the decisions of the first, with the same examples. Then
populations decide in the kinematic room, on all threads or on `--device`, and are held against the
least time that they could take on this machine: nearest neighbours the time to read the examples of
one region for each agent, networks the time that their multiplications take in a large matrix
product. Prints Markdown; `docs/benchmarks.md` holds a copy.

    python -m scripts.benchmarks.benchmark --no-robots --device cuda --populations knn:16384
        mlp:4096 --profile
"""

import os
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from random import random
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from torch import Tensor, nn
from torch.profiler import ProfilerActivity, profile

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from tests.agreement import oracle_of, scaled
from tests.oracle import Robot

WORLD = "torch_iac_envs/ToyRoom-v0"
KINEMATIC = "torch_iac_envs/ToyRoomKinematic-v0"


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
    "nearest neighbour": iac.IACConfig(meta=None),
    "nearest neighbour, with MP": iac.IACConfig(),
    "MLP": iac.IACConfig(experts=iac.MLPExperts(), meta=None),
    "any module": iac.IACConfig(experts=iac.NetworkExperts(module=Waves), meta=None),
}

EXPERTS: dict[str, iac.Experts] = {"knn": iac.KNNExperts(), "mlp": iac.MLPExperts()}


@dataclass(frozen=True)
class Benchmark:
    """How much is measured."""

    steps: int = 10_000
    """How many decisions the robot with nearest neighbours takes."""
    short_steps: int = 2_000
    """How many decisions the other robots take."""
    robots: bool = True
    """Whether single robots are measured."""
    populations: tuple[str, ...] = ("knn:512", "mlp:256")
    """Experts and numbers of agents of the populations that are measured."""
    population_steps: int = 1_000
    """How many decisions a population takes; the second half is timed."""
    device: str = "cpu"
    """Where populations decide."""
    profile: bool = False
    """Whether to say in which operations populations spend their time."""
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
    if benchmark.robots:
        torch.set_num_threads(1)
        print("\n| one robot, one thread | decisions | median ms | mean ms |\n|---|---|---|---|")
        for i, (name, config) in enumerate(ROBOTS.items()):
            measure_robot(name, config, benchmark, with_oracle=i == 0)
        torch.set_num_threads(threads)
    where = f"{threads} threads" if benchmark.device == "cpu" else device_name(benchmark.device)
    print(f"\n| population, {where} | agents | agent-decisions a second | with the world | floor |")
    print("|---|---|---|---|---|")
    for population in benchmark.populations:
        kind, _, n_agents = population.partition(":")
        measure_population(kind, int(n_agents), benchmark)


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
        follow_itself(iac.IAC(space, config, seeds=[benchmark.seed]), steps, stopwatch)
        follow(oracle_of(config), space, steps, config.n_candidates, stopwatch)
    rows: dict[str, tuple[str, ...]] = {f"{name}: act and observe": ("act", "observe")}
    if with_oracle:
        rows |= {f"{name}: the same without physics in between": ("again",)}
        rows |= {f"{name}: the oracle": ("oracle",), "the toy room": ("world",)}
    for row, parts in rows.items():
        times = stopwatch.last(benchmark.counted, *parts)
        print(f"| {row} | {n_decisions:,} | {np.median(times):.3f} | {times.mean():.3f} |")


def follow_itself(agent: iac.IAC, steps: Sequence[iac.Step], stopwatch: Stopwatch) -> None:
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


def measure_population(kind: str, n_agents: int, benchmark: Benchmark) -> None:
    """Let a population decide in the kinematic room and print how many decisions it takes."""
    device = torch.device(benchmark.device)
    env = gym.make_vec(KINEMATIC, n_agents, device=device, check_actions=False)
    space = iac.SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    config = iac.IACConfig(experts=EXPERTS[kind], meta=None)
    agent = iac.IAC(space, config, range(n_agents), device)
    half = benchmark.population_steps // 2
    sensors, _ = env.reset(seed=0)
    seen = decide(agent, env, sensors, half)
    with_world, seen = timed(device, lambda: decide(agent, env, seen[-1], half))
    alone, _ = timed(device, lambda: decide_again(agent, seen))
    floor = knn_floor(space, n_agents, device) if kind == "knn" else mlp_floor(n_agents, device)
    print(
        f"| {kind} | {n_agents:,} | {half * n_agents / alone:,.0f} "
        f"| {half * n_agents / with_world:,.0f} | {half * floor / alone:.1%} |"
    )
    if benchmark.profile:
        print_profile(
            device, lambda: [agent.act(sensors) is agent.observe(sensors) for _ in range(50)]
        )


def decide(
    agent: iac.IAC, env: gym.vector.VectorEnv[Any, Any, Any], sensors: Tensor, n_decisions: int
) -> list[Tensor]:
    """Let a population decide in its world and return what it sensed, first to last."""
    seen = [sensors]
    for _ in range(n_decisions):
        sensors, *_ = env.step(agent.act(sensors))
        agent.observe(sensors)
        seen.append(sensors)
    return seen


def decide_again(agent: iac.IAC, seen: Sequence[Tensor]) -> None:
    """Let a population decide on what was sensed before, whatever it does."""
    for before, after in pairwise(seen):
        agent.act(before)
        agent.observe(after)


def timed(device: torch.device, work: Callable[[], Any]) -> tuple[float, Any]:
    """Return how many seconds some work took, and what came of it."""
    wait(device)
    started = time.perf_counter()
    result = work()
    wait(device)
    return time.perf_counter() - started, result


def wait(device: torch.device) -> None:
    """Wait until a GPU has done what it was told."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def knn_floor(space: iac.SensorimotorSpace, n_agents: int, device: torch.device) -> float:
    """Return the seconds in which the examples of one region an agent can be read from memory."""
    n_bytes = n_agents * iac.IACConfig().max_examples * 4 * len(space.situation)
    block = torch.rand(2**26, device=device)
    seconds = min(timed(device, block.clone)[0] for _ in range(10))
    return n_bytes / (2 * 4 * len(block) / seconds)  # a copy reads and writes


def mlp_floor(n_agents: int, device: torch.device) -> float:
    """Return the seconds of the default MLP's multiplications at the speed of a large product."""
    n_weights = 14 * 32 + 32 * 32 + 32
    operations = 3 * 2 * n_weights * n_agents * 4 * 32  # forwards once, backwards twice as much
    size = 2048
    matrix = torch.rand(size, size, device=device)
    seconds = min(timed(device, lambda: matrix @ matrix)[0] for _ in range(10))
    return operations / (2 * size**3 / seconds)


def print_profile(device: torch.device, work: Callable[[], Any], n_rows: int = 12) -> None:
    """Print the operations that take most of the time of some work."""
    kinds = [ProfilerActivity.CUDA if device.type == "cuda" else ProfilerActivity.CPU]
    with profile(activities=kinds) as profiler:
        work()
        wait(device)
    spent = "self_device_time_total" if device.type == "cuda" else "self_cpu_time_total"
    events = sorted(profiler.key_averages(), key=lambda event: -getattr(event, spent))
    total = sum(getattr(event, spent) for event in events)
    print("\n| operation | share of the time | calls |\n|---|---|---|")
    for event in events[:n_rows]:
        print(f"| `{event.key}` | {getattr(event, spent) / total:.0%} | {event.count} |")
    print()


def device_name(device: str) -> str:
    """Return what a GPU calls itself."""
    return torch.cuda.get_device_name(device)


def cpu_model() -> str:
    """Return what the processor calls itself."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(": ")[1] for line in lines if line.startswith("model name")), "?")


if __name__ == "__main__":
    main(tyro.cli(Benchmark, description=__doc__))
