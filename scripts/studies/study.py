"""What the studies share: robots that develop in a toy room, several runs at once, each kept."""

import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from tqdm import tqdm

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.analysis.generalisation import TESTS, sets_aside, tested
from torch_iac.internal.files import dump_json, write_table
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.recorder import Recorder

WORLD = "torch_iac_envs/ToyRoom-v0"
KINEMATIC = "torch_iac_envs/ToyRoomKinematic-v0"

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
    live_together([life])


def clear_unfinished(folder: Path) -> bool:
    """Clear away what an interrupted study left of a run; return whether it is yet to be lived."""
    unfinished = not (folder / "summary.json").exists()
    if unfinished:
        shutil.rmtree(folder, ignore_errors=True)
    return unfinished


def live_together(lives: Sequence[Life]) -> None:
    """Let the robots of several runs develop side by side, as one vector of worlds.

    What a world does depends on its own seed only, so the runs are those that would have been.

    Args:
        lives: Runs of one length, in one kind of world; those that are there already are left out.
    """
    lives = [life for life in lives if clear_unfinished(life.folder)]
    if not lives:
        return
    torch.set_num_threads(1)
    seeds = [seed for life in lives for seed in life.seeds]
    env = gym.make_vec(lives[0].world, num_envs=len(seeds), **lives[0].options)
    with ExitStack() as stack:
        groups = [_Robots(life, env, stack) for life in lives]
        sensors, _ = env.reset(seed=seeds)  # type: ignore[arg-type]  # a list is fine
        for _ in range(lives[0].n_decisions):
            actions = [robots.act(mine) for robots, mine in _shared(groups, sensors)]
            join = torch.cat if isinstance(sensors, torch.Tensor) else np.concatenate
            sensors, _, _, _, info = env.step(join(actions))
            after = _shared(groups, sensors, info["zone"])
            for robots, mine, zones in after:
                robots.observe(mine, zones)
        for robots in groups:
            robots.close()
    env.close()


def live_all(lives: Iterable[Life], processes: int) -> list[Run]:
    """Let robots develop, some runs at once, and return their runs in order."""
    lives = list(lives)
    with ProcessPoolExecutor(processes) as pool:
        list(tqdm(pool.map(live, lives), total=len(lives), unit="run", disable=None))
    return [load_run(life.folder) for life in lives]


class Diary:
    """What is kept of robots while they develop: every decision, and a test now and then.

    Args:
        life: Their run.
        agent: They.
        env: Their world.
        stack: Closes the run's folder in the end.
    """

    def __init__(self, life: Life, agent: iac.IAC, env: Any, stack: ExitStack) -> None:
        self._life = life
        world = {"id": life.world, "options": dict(life.options)}
        described = {"iac": life.config.to_json(), "world": world}
        zones = env.metadata["zone_names"]
        self._recorder = stack.enter_context(Recorder(life.folder, agent, zones, described))
        self._tests: list[dict[str, Any]] = []

    def keep(self, agent: iac.IAC, step: iac.Step, zones: Any) -> None:
        """Keep what happened, and test now and then."""
        self._recorder.record(step, zones)
        every = self._life.test_every
        if every and agent.n_decisions % every == 0:
            options = tuple(self._life.options.items())
            self._tests += tested(agent, sets_aside(self._life.world, options))

    def close(self) -> None:
        """Keep the tests."""
        if self._tests:
            columns = {name: [test[name] for test in self._tests] for name in self._tests[0]}
            write_table(self._life.folder / TESTS, pa.table(columns))


class _Robots:
    """The robots of a run while they develop.

    Args:
        life: The run.
        env: Their worlds, and maybe others'.
        stack: Closes the run's folder in the end.
    """

    def __init__(self, life: Life, env: Any, stack: ExitStack) -> None:
        space = iac.SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
        self.agent = iac.IAC(space, life.config, life.seeds)
        self._folder = life.folder
        self._diary = Diary(life, self.agent, env, stack)
        self._seconds = 0.0

    def act(self, sensors: Any) -> Any:
        """Return the robots' actions."""
        started = time.process_time()
        actions = self.agent.act(sensors)
        self._seconds += time.process_time() - started
        return actions

    def observe(self, sensors: Any, zones: Any) -> None:
        """Learn, and keep what happened."""
        started = time.process_time()
        step = self.agent.observe(sensors)
        self._seconds += time.process_time() - started
        self._diary.keep(self.agent, step, zones)

    def close(self) -> None:
        """Keep the tests, and what the robots cost."""
        self._diary.close()
        kept = sum(tensor.nbytes for tensor in self.agent.state().values())
        costs = dump_json({"agent_seconds": self._seconds, "state_bytes": kept})
        (self._folder / COSTS).write_bytes(costs)


def _shared(groups: Sequence[_Robots], *rows: Any) -> Iterator[tuple[Any, ...]]:
    """Give each group of robots its part of some rows."""
    start = 0
    for robots in groups:
        mine = slice(start, start := start + robots.agent.n_agents)
        yield robots, *(of[mine] for of in rows)


def recorded(run: Run, names: Iterable[str]) -> NDArray[Any]:
    """Return some columns of what a run recorded, shape `(T, A, columns)`."""
    return np.stack([run.column(name) for name in names], axis=-1)
