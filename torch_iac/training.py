"""The loop of agents and environment."""

import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
from torch import Tensor

from torch_iac.agent import IAC
from torch_iac.internal.bars import tqdm
from torch_iac.internal.validation import check_count
from torch_iac.runs.checkpoint import Checkpoint, Checkpoints
from torch_iac.runs.recorder import Recorder
from torch_iac.worlds.saving import STATE, set_world_state, world_state
from torch_iac.worlds.vector import World, outcome_of, refuse_overwriting, zones_of

SECONDS_BETWEEN_LINES = 10.0
"""Seconds between two lines in the log, where there is no terminal for a progress bar."""

SECONDS_BETWEEN_LOOKS = 1.0
"""Seconds between two looks at the robots for the progress bar."""

CHECKPOINT_EVERY = 1000
"""Default number of decisions between two checkpoints."""

SHARE_FOR_CHECKPOINTS = 0.05
"""Largest share of the time for checkpoints; one that would take more is postponed."""

log = logging.getLogger(__name__)


def train(
    agent: IAC,
    env: World,
    n_decisions: int,
    recorder: Recorder | None = None,
    checkpoints: Checkpoints | None = None,
    *,
    checkpoint_every: int = CHECKPOINT_EVERY,
    stop: Callable[[], bool] = lambda: False,
    after: Callable[[IAC], object] = lambda _: None,
) -> bool:
    """Run the act, step, observe loop, one world an agent.

    The worlds start from the agents' seeds; if there is a checkpoint, everything goes on from it,
    bit for bit. Where episodes end, the outcome of the last decision is what the world showed
    before it started again.

    Args:
        agent: The population.
        env: As many worlds as there are agents.
        n_decisions: How many decisions each agent takes, with those taken before.
        recorder: Keeps what happened; None keeps nothing.
        checkpoints: Where to go on from, and where to save; None saves nothing.
        checkpoint_every: How many decisions lie between two checkpoints, or more where they would
            take over a twentieth of the time.
        stop: Asked after each decision whether to save and stop.
        after: Called with the agent after each decision, before it is saved: for tests during the
            run. A run that goes on from a checkpoint calls it again for the decisions that it takes
            again.

    Returns:
        Whether all decisions were taken.

    Raises:
        ValueError: The number of worlds is not that of the agents, fewer decisions are to be
            taken than were already, the world cannot be saved, a checkpoint does not fit, a
            world whose episodes end was not made with `AutoresetMode.SAME_STEP` or overwrites
            their last sensors, or some worlds tell of zones and others do not.
        FloatingPointError: A loss is not finite.
    """
    if not isinstance(env, gym.vector.VectorEnv):
        raise ValueError(f"env must be a vector of worlds, as gymnasium.make_vec makes, got {env}")
    if env.num_envs != agent.n_agents:
        raise ValueError(
            f"env must have as many worlds as there are agents ({agent.n_agents}), "
            f"got {env.num_envs}"
        )
    for name, value in (("n_decisions", n_decisions), ("checkpoint_every", checkpoint_every)):
        check_count(name, value)
    refuse_overwriting(env)
    sensors = _begin(agent, env, recorder, checkpoints)
    if n_decisions < agent.n_decisions:
        raise ValueError(
            f"n_decisions must be at least those already taken ({agent.n_decisions}), "
            f"got {n_decisions}"
        )
    saver = _Saver(agent, env, recorder, checkpoints) if checkpoints else None
    present = recorder.present if recorder is not None else str
    for _ in _counted(agent.n_decisions, n_decisions, present):
        sensors, _, terminated, truncated, info = env.step(agent.act(sensors))
        ends = terminated | truncated
        step = agent.observe(outcome_of(env, sensors, ends, info))
        if recorder is not None:
            recorder.record(step, zones_of(ends, info))
        after(agent)
        is_over = stop()
        is_due = agent.n_decisions % checkpoint_every == 0 and saver and saver.is_affordable
        if saver and (is_over or is_due or agent.n_decisions == n_decisions):
            saver.save(sensors)
        if is_over:
            break
    return agent.n_decisions == n_decisions


def _begin(
    agent: IAC, env: World, recorder: Recorder | None, checkpoints: Checkpoints | None
) -> Any:
    """Return the sensors from which the next decision is taken."""
    sensors, _ = env.reset(seed=list(agent.seeds))  # type: ignore[arg-type]  # a list is fine
    if checkpoints is None:
        return sensors
    try:
        world_state(env)  # checked now, not when the first checkpoint is due
    except AttributeError:
        raise ValueError(
            f"a world must have get_state and set_state, or worlds with {STATE}, to be saved, "
            f"got {env.unwrapped}"
        ) from None
    try:
        checkpoint = checkpoints.read()
    except FileNotFoundError:
        if recorder is not None:
            recorder.load_state(None, 0)
        return sensors
    agent.load_state(checkpoint.agent)
    set_world_state(env, checkpoint.world)
    if recorder is not None:
        recorder.load_state(checkpoint.loop["recorder"], checkpoint.n_decisions)
    saved = checkpoint.loop["sensors"]
    return saved.to(agent.device) if isinstance(saved, Tensor) else saved


class _Saver:
    """Writes checkpoints, as far as they keep to their share of the time."""

    def __init__(
        self, agent: IAC, env: World, recorder: Recorder | None, checkpoints: Checkpoints
    ) -> None:
        self._agent, self._env = agent, env
        self._recorder, self._checkpoints = recorder, checkpoints
        self._took, self._ended = 0.0, time.monotonic()

    @property
    def is_affordable(self) -> bool:
        """Whether another checkpoint keeps to its share of the time."""
        return self._took <= SHARE_FOR_CHECKPOINTS * (time.monotonic() - self._ended)

    def save(self, sensors: Any) -> None:
        """Save all; the next decision will be taken from these sensors."""
        started = time.monotonic()
        recorder = self._recorder.state() if self._recorder else None
        self._checkpoints.write(
            Checkpoint(
                self._agent.n_decisions,
                self._agent.state(),
                world_state(self._env),
                {"sensors": sensors, "recorder": recorder},
            )
        )
        self._ended = time.monotonic()
        self._took = self._ended - started


def _counted(taken: int, n_decisions: int, present: Callable[[], str]) -> Iterator[int]:
    """Count decisions, with a progress bar on a terminal and a line in the log now and then.

    Args:
        taken: How many were taken before.
        n_decisions: How many there will be.
        present: Says in a line what the robots do now; asked only when that is shown.
    """
    started = spoken = time.monotonic()
    bar = tqdm(
        range(taken, n_decisions), unit="decision", initial=taken, total=n_decisions, disable=None
    )
    interval = SECONDS_BETWEEN_LINES if bar.disable else SECONDS_BETWEEN_LOOKS
    with tqdm(bar_format="{desc}", position=1, leave=False, disable=None) as below:
        for number in bar:
            yield number
            now = time.monotonic()
            if now - spoken < interval:
                continue
            spoken, line = now, present()
            below.set_description_str(line)  # which is nothing where there is no terminal
            if bar.disable:
                rate, end = (number + 1 - taken) / (now - started), f": {line}" if line else ""
                log.info("%d of %d decisions, %.3g a second%s", number + 1, n_decisions, rate, end)
