"""The generalisation test: how well robots predict transitions that they did not choose.

Transitions are set aside that no robot learns from; now and then all robots predict them.

Shapes: `A` agents, `N` transitions, `P` tests.

Source: Oudeyer, Kaplan and Hafner (2007), who test on transitions collected under random actions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch
from numpy.typing import NDArray

from torch_iac.agent import IAC
from torch_iac.internal.files import open_table, write_table
from torch_iac.internal.validation import check_count
from torch_iac.runs.reader import Run
from torch_iac.space import SensorimotorSpace
from torch_iac.worlds.make import make_world
from torch_iac.worlds.vector import outcome_of, zones_of

PATIENCE = 1000
"""Decisions per transition after which a zone counts as not met."""

F2 = 1
"""The zone that is hard and can be learnt."""

TEST_SETS = {"met": False, "anywhere": True}
"""Whether each action starts from a pose drawn over the room, or from where random ones led."""

N_TESTED = 250
"""How many transitions a test set has."""

TEST_SEED = 1_000_000
"""Seeds the test sets; no robot has it."""

TESTS = "generalisation"
"""Folder of the generalisation tests in a run folder: a file for each, named by its decision."""


@dataclass(frozen=True)
class Transitions:
    """Sensors, actions and the outcomes that followed; raw units, float32.

    Attributes:
        actions: Shape `(N, action_dim)`.
        sensors: Shape `(N, sensor_dim)`, before the actions.
        outcomes: Shape `(N, K)`.
    """

    actions: NDArray[np.float32]
    sensors: NDArray[np.float32]
    outcomes: NDArray[np.float32]


@dataclass(frozen=True)
class TestErrors:
    """How far predictions are off, over all transitions and outcomes, in scaled units.

    Attributes:
        absolute: Shape `(A,)`, the mean absolute error.
        squared: Shape `(A,)`, the mean squared error.
    """

    __test__ = False  # keeps pytest from collecting it

    absolute: NDArray[np.float64]
    squared: NDArray[np.float64]


def collect(
    env: gym.vector.VectorEnv[Any, Any, Any],
    space: SensorimotorSpace,
    n_transitions: int,
    *,
    seed: int,
    zone: int | None = None,
    anew: bool = False,
) -> Transitions:
    """Return transitions under uniformly random actions.

    Args:
        env: One world or more; if episodes end by themselves, of `AutoresetMode.SAME_STEP`.
        space: Which sensors are outcomes.
        n_transitions: How many are returned.
        seed: Seeds the worlds and the actions.
        zone: Only transitions in this zone, by its number in `info["zone"]`; all if none is given,
            or the world has no zones.
        anew: Whether every action is taken from where a new episode starts, rather than from where
            the actions before have led.

    Raises:
        ValueError: `n_transitions` is below 1, the zone is not met, or episodes end in worlds that
            do not show it.
    """
    check_count("n_transitions", n_transitions)
    low, high = env.single_action_space.low, env.single_action_space.high  # type: ignore[attr-defined]
    draw = np.random.default_rng(seed)
    sensors, _ = env.reset(seed=seed)
    found: list[tuple[NDArray[Any], ...]] = []
    n_found = 0
    for _ in range(PATIENCE * n_transitions):
        actions = draw.uniform(low, high, (env.num_envs, len(low))).astype(np.float32)
        before = np.asarray(sensors).copy()  # worlds reuse their buffers
        sensors, _, terminated, truncated, info = env.step(actions)
        ends = terminated | truncated
        after = np.asarray(outcome_of(env, sensors, ends, info))[:, space.outcome_columns]
        here = np.full(env.num_envs, True)
        if zone is not None and (zones := zones_of(ends, info)) is not None:
            here &= np.asarray(zones) == zone
        found.append((actions[here], before[here], after[here]))
        n_found += int(here.sum())
        if n_found >= n_transitions:
            return Transitions(
                *(np.concatenate(of)[:n_transitions] for of in zip(*found, strict=True))
            )
        if anew:
            sensors, _ = env.reset()
    raise ValueError(f"zone must be one that random actions meet, got {zone}")


def errors_on(transitions: Transitions, agent: IAC) -> TestErrors:
    """Return how far each agent's predictions are off; it learns nothing from it.

    Raises:
        ValueError: The transitions do not fit the agents' space.
    """
    predictions = agent.predict(transitions.actions, transitions.sensors)  # (A, N, K)
    spans = np.array([outcome.high - outcome.low for outcome in agent.space.outcomes])
    off = (predictions - transitions.outcomes).astype(np.float64) / spans
    return TestErrors(np.abs(off).mean(axis=(1, 2)), np.square(off).mean(axis=(1, 2)))


def plateau(errors: NDArray[np.float64], n_tests: int, variance: float) -> NDArray[np.float64]:
    """Return the first test from which on errors hardly change; NaN if they never settle.

    Args:
        errors: Shape `(P, A)`.
        n_tests: Over how many tests, from that one on.
        variance: Below which variance they hardly change.

    Returns:
        Shape `(A,)`, counted from 0.

    Example:
        >>> plateau(np.array([[8.0], [2.0], [1.0], [1.0], [1.0]]), n_tests=3, variance=0.01)
        array([2.])

    Source: Oudeyer, Kaplan and Hafner (2007): 500 points with a variance below 0.0001.
    """
    if len(errors) < n_tests:
        return np.full(errors.shape[1], np.nan)
    spans = np.lib.stride_tricks.sliding_window_view(errors, n_tests, axis=0)
    is_flat = spans.var(axis=-1) < variance
    return np.where(is_flat.any(axis=0), is_flat.argmax(axis=0), np.nan)


def tested(agent: IAC, sets: Mapping[str, Transitions]) -> list[dict[str, Any]]:
    """Return a row for each robot and each set."""
    return [
        {"step": agent.n_decisions, "seed": seed, "set": name, "absolute": a, "squared": s}
        for name, transitions in sets.items()
        for found in [errors_on(transitions, agent)]
        for seed, a, s in zip(agent.seeds, found.absolute, found.squared, strict=True)
    ]


def record_tests(agent: IAC, sets: Mapping[str, Transitions], folder: Path) -> None:
    """Write how well the agents predict now into a run folder.

    Tests of later decisions, which a run that was killed has left, are the same that will be
    written, and stay until they are.
    """
    rows = pa.Table.from_pylist(tested(agent, sets))
    (folder / TESTS).mkdir(exist_ok=True)
    write_table(folder / TESTS / f"test-{agent.n_decisions:012d}.parquet", rows)


def load_tests(run: Run) -> pa.Table:
    """Return the tests of a run, in order: `step`, `seed`, `set`, `absolute` and `squared`.

    Raises:
        FileNotFoundError: It has none.
        ValueError: One cannot be read.
    """
    paths = sorted((run.folder / TESTS).glob("test-*.parquet"))
    if not paths:
        raise FileNotFoundError(f"{run.folder} holds no generalisation tests")
    return pa.concat_tables(open_table(path).read() for path in paths)


def sets_aside(world: str, options: Mapping[str, Any]) -> dict[str, Transitions]:
    """Return the test sets of a toy room: transitions in f2, of two kinds.

    They are collected once a process, which takes seconds: a worker makes many runs in one world.

    Args:
        world: Its name in an experiment.
        options: Its arguments.
    """
    return _collected(world, tuple(sorted(options.items())))


@cache
def _collected(world: str, options: tuple[tuple[str, Any], ...]) -> dict[str, Transitions]:
    env = make_world(world, 1, dict(options), torch.device("cpu"))
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
    tables = [load_tests(run).filter(pc.field("set") == which) for run in runs]
    rows = pa.concat_tables(tables).sort_by([("step", "ascending"), ("seed", "ascending")])
    steps = np.unique(rows["step"].to_numpy())
    return steps, rows[error].to_numpy().reshape(len(steps), -1)
