"""Scenes of a run: re-simulates recorded decisions and verifies them.

Shapes: `T` decisions, `S` sensors, `H` and `W` a picture's height and width.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray

from torch_iac.replay.length import N_DECISIONS
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import CONFIG, WINDOW
from torch_iac.runs.statistics import focus_steps
from torch_iac.space import Dimension
from torch_iac.toy_room import FOCUS_SHARES
from torch_iac.worlds.saving import set_world_state, world_state
from torch_iac.worlds.vector import World, outcome_of


@dataclass(frozen=True)
class Stage:
    """Consecutive decisions of a robot that are shown.

    Attributes:
        title: What they are, in a few words.
        first: The first of them.
        n_decisions: How many they are.
    """

    title: str
    first: int
    n_decisions: int


@dataclass(frozen=True)
class Scene:
    """One decision, re-simulated.

    Attributes:
        stage: What it belongs to.
        row: What was recorded of it, by column.
        pictures: Pictures of the world from its beginning to its end, each of shape `(H, W, 3)`.
    """

    stage: Stage
    row: Mapping[str, Any]
    pictures: Sequence[NDArray[np.uint8]]


def find_stages(run: Run, agent: int = 0, n_decisions: int = N_DECISIONS) -> list[Stage]:
    """Return the stages of a robot's development: beginning, focus on f3 and on f2, end.

    A focus is shown in the middle of the first window that has it (`toy_room.FOCUS_SHARES`);
    one that never comes is left out.

    Args:
        run: The run.
        agent: Which robot.
        n_decisions: How many decisions a stage has, at most.
    """
    starts = {"The beginning": 0}
    for zone, share in FOCUS_SHARES.items():
        step = focus_steps(run, zone, share)[agent] if zone in run.zone_names else None
        if step is not None:
            starts[f"The focus on {zone}"] = step + max(0, WINDOW - n_decisions) // 2
    if run.n_decisions > n_decisions:
        starts["The end"] = run.n_decisions - n_decisions
    return _in_order(run, starts, n_decisions)


def stages_at(run: Run, firsts: Sequence[int], n_decisions: int = N_DECISIONS) -> list[Stage]:
    """Return stages that begin with given decisions, in order.

    Raises:
        ValueError: The run has no such decision.
    """
    for first in firsts:
        if not 0 <= first < run.n_decisions:
            raise ValueError(f"decisions must lie in [0, {run.n_decisions}), got {first}")
    return _in_order(run, {f"From decision {first:,} on": first for first in firsts}, n_decisions)


def relive(
    run: Run, stages: Sequence[Stage], world: World, camera: World, agent: int = 0
) -> Iterator[Scene]:
    """Repeat a robot's recorded actions, and yield the scenes of the stages.

    Args:
        run: The run.
        stages: What to show, in order.
        world: One world, as the robot's was.
        camera: The same, but `render` gives the pictures of its last decision, or one.
        agent: Which robot.

    Raises:
        ValueError: A sensor does not read what was recorded, or the agent's steps are not recorded.
    """
    record = _Record(run, agent)
    record.begin(world)
    camera.reset()
    now = 0
    for stage in stages:
        for decision in range(now, stage.first):
            record.live(world, decision)
        now = stage.first
        _hand_over(world, camera)
        for decision in range(now, now + stage.n_decisions):
            record.live(camera, decision)
            yield Scene(stage, record.row(decision), _pictures(camera))


def _hand_over(world: World, camera: World) -> None:
    """Copy the state of the world to the camera's."""
    try:
        set_world_state(camera, world_state(world))
    except AttributeError:
        raise ValueError(
            "a world must have get_state and set_state, or worlds with full_state, to be replayed, "
            f"got {world.unwrapped}"
        ) from None


class _Record:
    """A robot's recorded actions and sensors, with which worlds are compared.

    Args:
        run: The run.
        agent: Which robot.
    """

    def __init__(self, run: Run, agent: int) -> None:
        self._run, self._seed = run, run.seeds[agent]
        self._rows = run.table(agent=agent)
        space = run.space
        self._columns = list(space.outcome_columns)
        self._actions = _recorded(self._rows, "action", space.actions)
        self._sensors = _recorded(self._rows, "sensor", space.sensors)
        self._outcomes = _recorded(self._rows, "outcome", space.outcomes)

    def row(self, decision: int) -> dict[str, Any]:
        """Return what was recorded of a decision."""
        row: dict[str, Any] = self._rows.slice(decision, 1).to_pylist()[0]
        return row

    def begin(self, world: World) -> None:
        """Reset a world as the robot's was."""
        sensors, _ = world.reset(seed=[self._seed])  # type: ignore[arg-type]  # a list is fine
        self._check_sensors(0, sensors)

    def live(self, world: World, decision: int) -> None:
        """Repeat a decision."""
        action = self._actions[decision : decision + 1]
        sensors, _, terminated, truncated, info = world.step(action)
        outcome = _array(outcome_of(world, sensors, terminated | truncated, info))
        names = [f"the next {dimension.name}" for dimension in self._run.space.outcomes]
        self._check(decision, names, outcome[self._columns], self._outcomes[decision])
        if decision + 1 < len(self._sensors):
            self._check_sensors(decision + 1, sensors)

    def _check_sensors(self, decision: int, sensors: Any) -> None:
        names = [dimension.name for dimension in self._run.space.sensors]
        self._check(decision, names, _array(sensors), self._sensors[decision])

    def _check(
        self,
        decision: int,
        names: Sequence[str],
        got: NDArray[np.float32],
        recorded: NDArray[np.float32],
    ) -> None:
        """Refuse values that differ from those recorded at a decision."""
        for name, value, known in zip(names, got, recorded, strict=True):
            if value != known:
                raise ValueError(
                    f"{name} must be {known} at decision {decision} as {self._run.folder} records, "
                    f"got {value}; its {CONFIG} says with which versions it was made"
                )


def _in_order(run: Run, firsts: Mapping[str, int], n_decisions: int) -> list[Stage]:
    """Return the stages with these titles and first decisions, cut where the run ends."""
    return [
        Stage(title, first, min(n_decisions, run.n_decisions - first))
        for title, first in sorted(firsts.items(), key=itemgetter(1))
    ]


def _recorded(rows: pa.Table, kind: str, of: Sequence[Dimension]) -> NDArray[np.float32]:
    """Return what was recorded of some dimensions, shape `(T, dimensions)`."""
    columns = [rows[f"{kind}/{dimension.name}"].to_numpy() for dimension in of]
    return np.stack(columns, axis=1).astype(np.float32)


def _array(sensors: Any) -> NDArray[np.float32]:
    """Return what the robot of a single world senses, shape `(S,)`."""
    first = torch.as_tensor(sensors)[0].float()  # as it is recorded
    values: NDArray[np.float32] = first.numpy(force=True)
    return values


def _pictures(camera: World) -> list[NDArray[np.uint8]]:
    shown = camera.render()
    pictures: Any = shown[0] if shown else []
    return pictures if isinstance(pictures, list) else [pictures]
