"""What the studies share: robots that develop in a toy room, several runs at once, each kept."""

import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from tqdm import tqdm

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.files import dump_json, write_table
from torch_iac.generalisation import Transitions, collect, errors_on
from torch_iac.recording import Recorder
from torch_iac.runs import Run, load_run
from torch_iac.space import SensorimotorSpace

WORLD = "torch_iac_envs/ToyRoom-v0"
KINEMATIC = "torch_iac_envs/ToyRoomKinematic-v0"

F2 = 1
"""The zone that is hard and can be learnt."""

TEST_SETS = {"met": False, "anywhere": True}
"""Whether each action starts from a pose drawn over the room, or from where random ones led."""

N_TESTED = 250
"""How many transitions a test set has."""

TEST_SEED = 1_000_000
"""Seeds the test sets; no robot has it."""

TESTS = "generalisation.parquet"
"""What a run folder keeps the generalisation tests in."""

COSTS = "costs.json"
"""What it keeps in which the robots' time and memory."""


@dataclass(frozen=True)
class Life:
    """A run: robots, and what is done with them.

    Attributes:
        folder: Where it is kept.
        config: The robots' numbers.
        seeds: One for each robot.
        n_decisions: How long it is.
        world: Where they live.
        options: The world's arguments.
        test_every: How many decisions lie between two generalisation tests; none without it.
    """

    folder: Path
    config: iac.IACConfig
    seeds: Sequence[int]
    n_decisions: int
    world: str = WORLD
    options: Mapping[str, Any] = field(default_factory=dict)
    test_every: int | None = None


def live(life: Life) -> None:
    """Let its robots develop, unless the run is there already."""
    if (life.folder / "summary.json").exists():
        return
    torch.set_num_threads(1)
    env = gym.make_vec(life.world, num_envs=len(life.seeds), **life.options)
    space = iac.SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    agent = iac.IAC(space, life.config, life.seeds)
    world = {"id": life.world, "options": dict(life.options)}
    described = {"iac": life.config.to_json(), "world": world}
    with Recorder(life.folder, agent, env.metadata["zone_names"], described) as recorder:
        _develop(life, agent, env, recorder)
    env.close()


def live_all(lives: Iterable[Life], processes: int) -> list[Run]:
    """Let robots develop, some at once, and return their runs in order."""
    lives = list(lives)
    with ProcessPoolExecutor(processes) as pool:
        list(tqdm(pool.map(live, lives), total=len(lives), unit="run", disable=None))
    return [load_run(life.folder) for life in lives]


def _develop(life: Life, agent: iac.IAC, env: Any, recorder: Recorder) -> None:
    """Take the decisions, test now and then, and note what the robots cost."""
    tests: list[dict[str, Any]] = []
    seconds = 0.0
    sensors, _ = env.reset(seed=list(life.seeds))
    while agent.n_decisions < life.n_decisions:
        started = time.process_time()
        actions = agent.act(sensors)
        acted = time.process_time()
        sensors, _, _, _, info = env.step(actions)
        moved = time.process_time()
        step = agent.observe(sensors)
        seconds += time.process_time() - moved + acted - started
        recorder.record(step, info["zone"])
        if life.test_every and agent.n_decisions % life.test_every == 0:
            tests += _tested(agent, _test_sets(life.world, tuple(life.options.items())))
    if tests:
        columns = {name: [test[name] for test in tests] for name in tests[0]}
        write_table(life.folder / TESTS, pa.table(columns))
    kept = sum(tensor.nbytes for tensor in agent.state().values())
    costs = dump_json({"agent_seconds": seconds, "state_bytes": kept})
    (life.folder / COSTS).write_bytes(costs)


def _tested(agent: iac.IAC, sets: Mapping[str, Transitions]) -> list[dict[str, Any]]:
    """Return a row for each robot and each set."""
    return [
        {"step": agent.n_decisions, "seed": seed, "set": name, "absolute": a, "squared": s}
        for name, transitions in sets.items()
        for found in [errors_on(transitions, agent)]
        for seed, a, s in zip(agent.seeds, found.absolute, found.squared, strict=True)
    ]


@cache
def _test_sets(world: str, options: tuple[tuple[str, Any], ...]) -> dict[str, Transitions]:
    """Return what is set aside in a world: transitions in f2, of two kinds."""
    env = gym.make_vec(world, num_envs=1, **dict(options))
    space = SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    sets = {
        name: collect(env, space, N_TESTED, seed=TEST_SEED, zone=F2, anew=anew)
        for name, anew in TEST_SETS.items()
    }
    env.close()
    return sets


def tests_of(runs: Sequence[Run], which: str, error: str) -> tuple[np.ndarray, np.ndarray]:
    """Return when robots were tested, shape `(P,)`, and their errors, shape `(P, A)`, by seed.

    Args:
        runs: Their runs.
        which: On which of `TEST_SETS`.
        error: Which error, absolute or squared, in scaled units.
    """
    tables = [pq.read_table(run.folder / TESTS, filters=[("set", "=", which)]) for run in runs]
    rows = pa.concat_tables(tables).sort_by([("step", "ascending"), ("seed", "ascending")])
    steps = np.unique(rows["step"].to_numpy())
    return steps, rows[error].to_numpy().reshape(len(steps), -1)
