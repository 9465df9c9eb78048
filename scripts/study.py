"""What the studies share: robots that develop in a toy room, several runs at once, each kept."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import torch
from tqdm import tqdm

import torch_iac as iac
import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.recording import Recorder
from torch_iac.runs import Run, load_run
from torch_iac.training import train

WORLD = "torch_iac_envs/ToyRoom-v0"


@dataclass(frozen=True)
class Life:
    """A run: where it is kept, its numbers, each robot's seed, how long, and in which world."""

    folder: Path
    config: iac.IACConfig
    seeds: Sequence[int]
    n_decisions: int
    world: str = WORLD


def live(life: Life) -> None:
    """Let its robots develop, unless the run is there already."""
    if (life.folder / "summary.json").exists():
        return
    torch.set_num_threads(1)
    env = gym.make_vec(life.world, num_envs=len(life.seeds))
    space = iac.SensorimotorSpace.from_env(env, outcomes=["toy_distance"])
    agent = iac.IAC(space, life.config, life.seeds)
    described = {"iac": life.config.to_json(), "world": {"id": life.world}}
    with Recorder(life.folder, agent, env.metadata["zone_names"], described) as recorder:
        train(agent, env, life.n_decisions, recorder)
    env.close()


def live_all(lives: Iterable[Life], processes: int) -> list[Run]:
    """Let robots develop, some at once, and return their runs in order."""
    lives = list(lives)
    with ProcessPoolExecutor(processes) as pool:
        list(tqdm(pool.map(live, lives), total=len(lives), unit="robot", disable=None))
    return [load_run(life.folder) for life in lives]
