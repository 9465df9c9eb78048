"""Writes the transitions of a run as a Minari data set.

Shapes: `T` decisions, `N` transitions of an episode, `S` sensors, `K` outcomes.
"""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from torch_iac.runs.reader import Run
from torch_iac.space import Dimension

NAME = re.compile(r"([\w-]+/)*[\w-]+-v\d+", re.ASCII)
"""What Minari takes for a data set's name."""

FOLDER_STARTS = ("/", "./", "../")
"""How a data set begins that is a folder, not a name."""

ROOT_VARIABLE = "MINARI_DATASETS_PATH"
"""The environment variable that says where Minari's data sets are."""


@dataclass(frozen=True)
class Episode:
    """Consecutive transitions of a robot, in raw units.

    Attributes:
        observations: Shape `(N + 1, S)`, before each action and after the last.
        actions: Shape `(N, action_dim)`.
        progress: Shape `(N,)`: the learning progress of the region that predicted.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    progress: NDArray[np.float64]


def save_minari(run: Run, target: str) -> str:
    """Write the transitions of all recorded robots as a Minari data set, and return where it is.

    The rewards are the learning progress of the region that predicted, since robots of this
    library ignore those of the world. An episode ends where the world's did or the run does.

    Args:
        run: The run.
        target: The data set's name in Minari's own folder, such as `toyroom/curious-v0`; or its
            folder, which begins with `/`, `./` or `../`.

    Raises:
        ValueError: The name is none for Minari or taken, Minari is missing, or the run is too
            short.
    """
    minari = _imported()
    root, name = _root_and_name(target)
    episodes = [e for agent in range(run.n_recorded) for e in episodes_of(run, agent)]
    if not episodes:
        raise ValueError(f"an episode must have two decisions, got none that has in {run.folder}")
    with _datasets_in(root), catch_warnings(category=UserWarning, action="ignore"):
        if name in minari.list_local_datasets():
            raise ValueError(f"a data set must have a new name, got {target}, which is there")
        # Minari warns where it is told neither an author's address nor scores of experts.
        data = minari.create_dataset_from_buffers(
            name,
            [_buffer(minari, number, episode) for number, episode in enumerate(episodes)],
            observation_space=_box(run.space.sensors),
            action_space=_box(run.space.actions),
            algorithm_name="Intelligent Adaptive Curiosity",
            code_permalink="https://pypi.org/project/torch_iac",
            description=f"Robots of torch_iac in {run.config.get('world', 'a world')}; rewards are "
            "learning progress.",
            data_format="arrow",
        )
        return str(data.storage.data_path)


def episodes_of(run: Run, agent: int = 0) -> list[Episode]:
    """Return the episodes of a robot, in order.

    Where not all sensors are predicted, what an episode's last action led to was not recorded, so
    that this transition is left out; and an episode of nothing else is, too.
    """
    space, steps = run.space, run.table(agent=agent)
    actions = _columns(steps, "action", space.actions)
    sensors = _columns(steps, "sensor", space.sensors)
    outcomes = _columns(steps, "outcome", space.outcomes)
    is_whole = len(space.outcomes) == len(space.sensors)
    seen = list(space.outcome_columns)
    # After an episode's end the world begins anew, so that its last outcome is not read again.
    is_last = (outcomes[:-1] != sensors[1:, seen]).any(axis=1)
    firsts = [0, *(np.flatnonzero(is_last) + 1).tolist(), len(actions)]
    progress, episodes = steps["progress"].to_numpy(), []
    for start, end in pairwise(firsts):
        observations = sensors[start:end]
        if is_whole:
            final = np.empty_like(sensors[:1])
            final[0, seen] = outcomes[end - 1]
            observations = np.concatenate([observations, final])
        kept = slice(start, start + len(observations) - 1)
        if len(observations) > 1:
            episodes.append(Episode(observations, actions[kept], progress[kept]))
    return episodes


def _imported() -> Any:
    try:
        import minari
    except ImportError:
        raise ValueError("--minari needs Minari: pip install 'torch_iac[minari]'") from None
    return minari


def _root_and_name(target: str) -> tuple[Path | None, str]:
    """Return the folder of data sets, None for Minari's own, and the name of this one.

    Raises:
        ValueError: The name is none for Minari.
    """
    root, name = None, target
    if target.startswith(FOLDER_STARTS):
        root, name = Path(target).parent, Path(target).name
    if not NAME.fullmatch(name):
        raise ValueError(f"a Minari data set must be named as toyroom/curious-v0 is, got {target}")
    return root, name


@contextmanager
def _datasets_in(root: Path | None) -> Iterator[None]:
    """Let Minari's data sets be in a folder; in its own if none is given."""
    before = os.environ.get(ROOT_VARIABLE)
    if root is not None:
        os.environ[ROOT_VARIABLE] = str(root.absolute())
    try:
        yield
    finally:
        os.environ.pop(ROOT_VARIABLE, None)
        if before is not None:
            os.environ[ROOT_VARIABLE] = before


def _buffer(minari: Any, number: int, episode: Episode) -> Any:
    n_transitions = len(episode.actions)
    is_last = np.arange(n_transitions) == n_transitions - 1
    return minari.data_collector.EpisodeBuffer(
        id=number,
        observations=episode.observations,
        actions=episode.actions,
        rewards=episode.progress,
        terminations=np.zeros(n_transitions, np.bool_),
        truncations=is_last,
    )


def _box(dimensions: Sequence[Dimension]) -> gym.spaces.Box:
    low, high = ([getattr(d, end) for d in dimensions] for end in ("low", "high"))
    return gym.spaces.Box(np.array(low, np.float32), np.array(high, np.float32))


def _columns(steps: Any, kind: str, dimensions: Sequence[Dimension]) -> NDArray[np.float32]:
    """Return what was recorded of some dimensions, shape `(T, dimensions)`."""
    columns = [steps[f"{kind}/{dimension.name}"].to_numpy() for dimension in dimensions]
    return np.stack(columns, axis=1).astype(np.float32)
