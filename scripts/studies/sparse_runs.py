"""Runs of `scripts.studies.sparse_reward`: SAC in the maze, with a bonus added to its reward.

Each run is kept in a file of its own as soon as it is done, with its settings.

Shapes: `T` decisions, `E` tests, `W` windows of decisions.
"""

import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Self

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC

import torch_iac as iac
from scripts.studies.sparse_bonuses import ICM, RND, Added, CuriosityReward, shapes_of
from scripts.studies.sparse_maze import Diary, coverage, make_maze
from torch_iac.internal.files import replace

Array = NDArray[Any]
Values = NDArray[np.float64]

NONE, PROGRESS = "none", "progress"
BONUSES = (NONE, "rnd", "icm", PROGRESS)


@dataclass(frozen=True)
class Learner:
    """What SAC is told that is not its default; the same with each bonus."""

    gamma: float = 0.98
    """How much the next decision's reward counts."""
    learning_starts: int = 500
    """As many random actions come first; so long there is no bonus."""
    train_freq: int = 4
    """Decisions between two gradient steps."""
    batch_size: int = 128
    """Decisions that a gradient step is made of."""
    learning_rate: float = 1e-3
    """Of actor, critics and entropy coefficient."""
    ent_coef: str = "auto_0.1"
    """The entropy coefficient is found by SAC, from 0.1 on."""
    net_arch: tuple[int, ...] = (64, 64)
    """Hidden units of actor and critics."""


@dataclass(frozen=True)
class Task:
    """What is run."""

    bonus: str
    """One of `BONUSES`."""
    coefficient: float
    """What it is multiplied by; the goal gives 1."""
    seed: int
    """Of everything in the run, but not of the tests."""
    steps: int = 10_000
    """How many decisions there are."""
    hold: int = 5
    """For how many steps of the simulation an action is held."""
    tests: int = 20
    """In how many episodes is tested at the end what was learnt; their seeds are 0, 1, ..."""
    learner: Learner = Learner()

    def path(self, folder: Path) -> Path:
        """Return where its outcome is kept."""
        return folder / f"{self.bonus}-{self.coefficient:g}" / f"{self.seed}.npz"

    def settings(self) -> str:
        """Return all of that as JSON."""
        return json.dumps(asdict(self))


@dataclass(frozen=True)
class Outcome:
    """What came of a run.

    Attributes:
        places: Where the ball was after each decision, shape `(T, 2)`.
        rewards: What the maze gave for each, shape `(T,)`.
        ends: Whether an episode ended with it, shape `(T,)`.
        passed: Whether each test reached the goal, shape `(E,)`.
    """

    places: NDArray[np.float32]
    rewards: NDArray[np.float32]
    ends: NDArray[np.bool_]
    passed: NDArray[np.bool_]

    @classmethod
    def read(cls, task: Task, folder: Path) -> Self:
        """Return what was kept.

        Raises:
            ValueError: It came of other settings.
        """
        with np.load(task.path(folder)) as kept:
            columns = dict(kept)
        if columns.pop("settings").item() != task.settings():
            raise ValueError(f"out must hold runs with these settings only, got {folder}")
        return cls(**columns)

    def write(self, task: Task, folder: Path) -> None:
        """Keep it, with the settings."""
        path = task.path(folder)
        path.parent.mkdir(parents=True, exist_ok=True)

        def save(to: Path) -> None:
            with to.open("wb") as file:
                np.savez_compressed(file, settings=np.array(task.settings()), **vars(self))

        replace(path, save)

    @property
    def first_success(self) -> int:
        """The decision that first reached the goal; the one after the last if none did."""
        return int(np.append(self.rewards, 1.0).argmax()) + 1

    def successes(self, n_windows: int) -> Values:
        """Return which share of the episodes that end in each window reached the goal.

        Returns:
            Shape `(W,)`; NaN where none ends.
        """
        ends = np.flatnonzero(self.ends)
        reached = np.maximum.reduceat(self.rewards, np.append(0, ends[:-1] + 1))
        windows = ends * n_windows // len(self.ends)
        n_ends = np.bincount(windows, minlength=n_windows)
        n_reached = np.bincount(windows, reached > 0, n_windows)
        shares = np.full(n_windows, np.nan)
        np.divide(n_reached, n_ends, out=shares, where=n_ends > 0)
        return shares

    def coverages(self, n_windows: int) -> Values:
        """Return which share of the maze was visited by the end of each window, shape `(W,)`."""
        ends = np.arange(1, n_windows + 1) * len(self.places) // n_windows
        return coverage(self.places)[ends - 1]


def run(tasks: Sequence[Task], folder: Path, processes: int) -> list[Outcome]:
    """Run what is not in the folder yet, and return what came of all."""
    missing = [task for task in tasks if not task.path(folder).exists()]
    context = get_context("spawn")  # a fork would copy locks held by threads, without them
    with ProcessPoolExecutor(processes, context) as pool:
        list(pool.map(partial(_run_one, folder=folder), missing))
    return [Outcome.read(task, folder) for task in tasks]


def _run_one(task: Task, folder: Path) -> None:
    torch.set_num_threads(1)
    torch.distributions.Distribution.set_default_validate_args(False)  # for speed
    learn(task).write(task, folder)
    print(f"{task.bonus}, {task.coefficient:g}, seed {task.seed}: done", flush=True)


def learn(task: Task) -> Outcome:
    """Let SAC learn, and test what it learnt."""
    torch.manual_seed(task.seed)
    maze = make_maze(task.hold)
    numbers = asdict(task.learner)
    # One loop over all weights; it saves a tenth of the time.
    policy = {"net_arch": list(numbers.pop("net_arch")), "optimizer_kwargs": {"fused": True}}
    env = with_bonus(maze, task)
    sac = SAC("MlpPolicy", env, policy_kwargs=policy, seed=task.seed, device="cpu", **numbers)
    sac.learn(task.steps)
    env.close()
    return Outcome(
        np.array(maze.places, np.float32),
        np.array(maze.rewards, np.float32),
        np.array(maze.ends),
        test(sac, task),
    )


def with_bonus(maze: Diary, task: Task) -> gym.Env[Array, Array]:
    """Return the maze with what SAC is to maximise as its reward."""
    if task.bonus == NONE:
        return maze
    bonus = _giver(maze, task)
    learner = task.learner
    return Added(bonus, maze, task.coefficient, learner.gamma, learner.learning_starts)


def _giver(maze: Diary, task: Task) -> gym.Env[Array, Array]:
    """Return the maze with the bonus alone as its reward."""
    if task.bonus == PROGRESS:
        return iac.ProgressReward(maze, iac.IACConfig(meta=None), seed=task.seed)
    (n_sensors,), (n_actions,) = shapes_of(maze)
    curiosity = RND(n_sensors) if task.bonus == "rnd" else ICM(n_sensors, n_actions)
    return CuriosityReward(maze, curiosity, task.seed)


def test(sac: SAC, task: Task) -> NDArray[np.bool_]:
    """Return which episodes reach the goal when actions are not drawn by chance, shape `(E,)`."""
    maze = make_maze(task.hold)
    passed = [_reaches(maze, sac, seed) for seed in range(task.tests)]
    maze.close()
    return np.array(passed)


def _reaches(maze: Diary, sac: SAC, seed: int) -> bool:
    observation, _ = maze.reset(seed=seed)
    reward, is_over = 0.0, False
    while not (reward or is_over):
        action, _ = sac.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, _ = maze.step(action)
        is_over = terminated or truncated
    return reward > 0
