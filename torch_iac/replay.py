"""Lives decisions of a run again, to look at them: which ones, and that they come out as recorded.

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

from torch_iac.measures import FOCUS_SHARES
from torch_iac.runs import CONFIG, WINDOW, Run, focus_steps
from torch_iac.training import World, set_world_state, world_state

N_DECISIONS = 20
"""How many decisions a stage has, if nobody says otherwise."""


@dataclass(frozen=True)
class Stage:
    """Some consecutive decisions of a robot that are looked at.

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
    """One decision, lived again.

    Attributes:
        stage: What it belongs to.
        row: What was recorded of it, by column.
        pictures: What it looked like, from its beginning to its end, each of shape `(H, W, 3)`.
    """

    stage: Stage
    row: Mapping[str, Any]
    pictures: Sequence[NDArray[np.uint8]]


def find_stages(run: Run, agent: int = 0, n_decisions: int = N_DECISIONS) -> list[Stage]:
    """Return the stages of a robot's development: beginning, focus on f3 and on f2, end.

    A focus is looked at in the middle of the first window that has it (`measures.FOCUS_SHARES`);
    one that never comes is left out.
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
    """Let a robot's recorded actions happen again, and show those of the stages.

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
    """Put the camera's world where the other is."""
    try:
        set_world_state(camera, world_state(world))
    except AttributeError:
        raise ValueError(
            "a world must have get_state and set_state, or worlds with full_state, to be replayed, "
            f"got {world.unwrapped}"
        ) from None


class _Record:
    """What a robot did and sensed, and whether worlds agree with it.

    Args:
        run: The run.
        agent: Which robot.
    """

    def __init__(self, run: Run, agent: int) -> None:
        self._run, self._seed = run, run.seeds[agent]
        self._rows = run.table(agent=agent)
        self._names = [dimension.name for dimension in run.space.sensors]
        actions = [f"action/{dimension.name}" for dimension in run.space.actions]
        self._actions = _columns(self._rows, actions)  # (T, actions)
        # What is sensed before each decision, and after the last only the outcome, (T + 1, S).
        sensed = _columns(self._rows, [f"sensor/{name}" for name in self._names])
        last = np.full((1, len(self._names)), np.nan, np.float32)
        outcomes = [f"outcome/{dimension.name}" for dimension in run.space.outcomes]
        last[0, list(run.space.outcome_columns)] = _columns(self._rows, outcomes)[-1]
        self._sensed = np.concatenate([sensed, last])

    def row(self, decision: int) -> dict[str, Any]:
        """Return what was recorded of a decision."""
        row: dict[str, Any] = self._rows.slice(decision, 1).to_pylist()[0]
        return row

    def begin(self, world: World) -> None:
        """Put a world where the robot's began."""
        sensors, _ = world.reset(seed=[self._seed])  # type: ignore[arg-type]  # a list is fine
        self._check(0, sensors)

    def live(self, world: World, decision: int) -> None:
        """Let a decision happen again."""
        sensors, *_ = world.step(self._actions[decision : decision + 1])
        self._check(decision + 1, sensors)

    def _check(self, decision: int, sensors: Any) -> None:
        """Refuse sensors, shape `(1, S)`, that are not those recorded before a decision."""
        got, recorded = torch.as_tensor(sensors).numpy(force=True)[0], self._sensed[decision]
        differing = np.flatnonzero((got != recorded) & ~np.isnan(recorded))
        if len(differing):
            sensor = differing[0]
            raise ValueError(
                f"{self._names[sensor]} must be {recorded[sensor]} before decision {decision} as "
                f"{self._run.folder} records, got {got[sensor]}; its {CONFIG} says with which "
                "versions it was made"
            )


def _in_order(run: Run, firsts: Mapping[str, int], n_decisions: int) -> list[Stage]:
    """Return the stages with these titles and first decisions, cut where the run ends."""
    return [
        Stage(title, first, min(n_decisions, run.n_decisions - first))
        for title, first in sorted(firsts.items(), key=itemgetter(1))
    ]


def _columns(rows: pa.Table, names: Sequence[str]) -> NDArray[np.float32]:
    return np.stack([rows[name].to_numpy() for name in names], axis=1).astype(np.float32)


def _pictures(camera: World) -> list[NDArray[np.uint8]]:
    shown = camera.render()
    pictures: Any = shown[0] if shown else []
    return pictures if isinstance(pictures, list) else [pictures]
