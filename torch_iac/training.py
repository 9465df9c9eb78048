"""The loop that joins a population of agents and its world."""

import logging
import time
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
from tqdm import tqdm

from torch_iac.agent import IAC
from torch_iac.recording import Recorder

SECONDS_BETWEEN_LINES = 10.0
"""How often the log speaks of the run where there is no terminal for a progress bar."""

log = logging.getLogger(__name__)


def train(
    agent: IAC,
    env: gym.vector.VectorEnv[Any, Any, Any],
    n_decisions: int,
    recorder: Recorder | None = None,
) -> None:
    """Let a population live in its world, one world an agent.

    The worlds start from the agents' seeds.

    Args:
        agent: The population.
        env: As many worlds as there are agents.
        n_decisions: How many decisions each agent takes.
        recorder: Keeps what happened; None keeps nothing.

    Raises:
        ValueError: The number of worlds is not that of the agents, or there are no decisions.
    """
    if env.num_envs != agent.n_agents:
        raise ValueError(
            f"env must have as many worlds as there are agents ({agent.n_agents}), "
            f"got {env.num_envs}"
        )
    if n_decisions < 1:
        raise ValueError(f"n_decisions must be at least 1, got {n_decisions}")
    sensors, _ = env.reset(seed=list(agent.seeds))  # type: ignore[arg-type]  # a list is fine
    for _ in _counted(n_decisions):
        sensors, _, _, _, info = env.step(agent.act(sensors))
        step = agent.observe(sensors)
        if recorder is not None:
            recorder.record(step, info.get("zone"))


def _counted(n_decisions: int) -> Iterator[int]:
    """Count decisions, with a progress bar on a terminal and a line in the log now and then."""
    started = spoken = time.monotonic()
    bar = tqdm(range(n_decisions), unit="decision", disable=None)
    for number in bar:
        yield number
        now = time.monotonic()
        if bar.disable and now - spoken >= SECONDS_BETWEEN_LINES:
            spoken = now
            rate = (number + 1) / (now - started)
            log.info("%d of %d decisions, %.0f a second", number + 1, n_decisions, rate)
