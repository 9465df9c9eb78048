"""Holds a decision of the engine against the oracle's."""

import pytest
from torch import Tensor

from tests.oracle import Robot
from torch_iac import Dimension, IACConfig, KNNExperts, SensorimotorSpace, Step

GRID = 2**23
"""Scaled values are whole multiples of 1 / GRID."""


def oracle_of(config: IACConfig) -> Robot:
    """Return the robot of the paper that has an engine's numbers."""
    assert isinstance(config.experts, KNNExperts)
    return Robot(
        max_examples=config.max_examples,
        balance=config.balance,
        window=config.window,
        delay=config.delay,
        k=config.experts.k,
        squared=config.error == "squared",
        inherit_history=config.inherit_history,
    )


def check_step(space: SensorimotorSpace, robot: Robot, step: Step) -> None:
    """Let the oracle live through a decision that the engine took, and compare."""
    situation = scaled(space.actions, step.actions) + scaled(space.sensors, step.sensors)
    outcome = scaled(space.outcomes, step.outcomes)
    region, prediction, error, progress = robot.observe(situation, outcome)
    assert step.regions.item() == region
    assert scaled(space.outcomes, step.predictions) == pytest.approx(prediction, abs=1e-6)
    assert step.errors.item() == pytest.approx(error, abs=1e-6)
    assert step.progress.item() == pytest.approx(progress, abs=1e-6)


def scaled(dimensions: tuple[Dimension, ...], raw: Tensor) -> list[float]:
    """Scale one row of raw values to the unit interval, in plain numbers."""
    pairs = zip(dimensions, raw[0].tolist(), strict=True)
    return [
        round(min(max((value - d.low) / (d.high - d.low), 0), 1) * GRID) / GRID
        for d, value in pairs
    ]
