"""The engine against the paper's oracle, alone and in a population, and against bad input."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from tests.agreement import check_step, oracle_of, scaled
from torch_iac import IAC, PRESETS, Dimension, IACConfig, KNNExperts, SensorimotorSpace, Step
from torch_iac.drives import Random

SMALL = IACConfig(n_candidates=5, max_examples=20, window=8, delay=8)
"""Splits often, so that a short run shows much."""


class Pendulum:
    """A small world: `far` follows the push, and noise if the tone is low; one a seed."""

    def __init__(self, seeds: list[int]) -> None:
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self.near = np.ones(len(seeds))

    def sense(self, far: np.ndarray) -> np.ndarray:
        return np.stack([self.near, far], axis=1).astype(np.float32)

    def reset(self) -> np.ndarray:
        return self.sense(np.zeros(len(self.generators)))

    def step(self, actions: np.ndarray) -> np.ndarray:
        noise = np.array([generator.uniform(-1, 1) for generator in self.generators])
        self.near = np.clip(self.near + 0.3 * actions[:, 0], 0, 2)
        return self.sense(np.where(actions[:, 1] < 4, noise, self.near))


def live(agent: IAC, n_decisions: int) -> list[Step]:
    world = Pendulum(list(agent.seeds))
    sensors, steps = world.reset(), []
    for _ in range(n_decisions):
        sensors = world.step(agent.act(sensors))
        steps.append(agent.observe(sensors))
    return steps


@pytest.mark.parametrize(
    "config",
    [
        SMALL,
        replace(SMALL, experts=KNNExperts(k=3)),
        replace(SMALL, error="squared", window=6, delay=3, balance=0.0),
        replace(SMALL, inherit_history=False),
    ],
    ids=["1-nn", "3-nn", "2007", "no history inherited"],
)
@pytest.mark.parametrize("seed", range(3))
def test_every_decision_is_the_oracles(
    space: SensorimotorSpace, config: IACConfig, seed: int
) -> None:
    robot = oracle_of(config)
    agent = IAC(space, config, seeds=[seed])
    for step in live(agent, 600):
        check_step(space, robot, step)
    assert robot.n_regions > 20


def test_the_best_candidate_is_the_oracles(space: SensorimotorSpace) -> None:
    config = replace(SMALL, epsilon=0.0)
    agent, robot = IAC(space, config, seeds=[5]), oracle_of(config)
    world = Pendulum([5])
    sensors = world.reset()
    for number in range(400):
        raw = agent.act(sensors)
        context = scaled(space.sensors, torch.as_tensor(sensors))
        actions = agent._choices.at(number)[0, 2:].view(5, 2).tolist()
        candidates = [action + context for action in actions]
        chosen = candidates[robot.choose(candidates)]
        assert scaled(space.actions, torch.as_tensor(raw)) == pytest.approx(chosen[:2], abs=1e-6)
        sensors = world.step(raw)
        check_step(space, robot, agent.observe(sensors))


@pytest.mark.parametrize("config", [SMALL, replace(SMALL, experts=KNNExperts(k=3))])
def test_an_agent_of_a_population_has_the_run_that_it_has_alone(
    space: SensorimotorSpace, config: IACConfig
) -> None:
    seeds = list(range(64))
    together = live(IAC(space, config, seeds), 300)
    for agent in (0, 1, 17, 63):
        alone = live(IAC(space, config, [seeds[agent]]), 300)
        for one, of_many in zip(alone, together, strict=True):
            for name, value in vars(one).items():
                if isinstance(value, torch.Tensor):
                    assert torch.equal(value[0], getattr(of_many, name)[agent]), name


def test_every_example_lies_in_the_region_that_routing_returns(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL, seeds=[0, 1])
    live(agent, 500)
    leaves = agent.tree.leaves()
    for leaf in leaves.tolist():
        row = int(agent.tree.rows[leaf])
        held = agent.examples.situations[row, :, : int(agent.examples.counts[row])].T
        both = held.expand(2, -1, -1)  # ask both agents' trees; the leaf belongs to one
        assert (agent.tree.route(both)[agent.tree.agent[leaf]] == leaf).all()
    summary = agent.region_summary()
    for agent_number in (0, 1):
        assert summary.n_examples[summary.agent == agent_number].sum() == 500
    volumes = (summary.highs - summary.lows).prod(dim=1)
    assert volumes.sum().item() == pytest.approx(2.0, abs=1e-5)


def test_a_region_that_cannot_be_cut_forgets_its_oldest_example() -> None:
    wire = Dimension("x", 0.0, 1.0)
    space = SensorimotorSpace((Dimension("a", 0.0, 1.0),), (wire,), (wire,))
    agent = IAC(space, replace(SMALL, max_examples=4, balance=0.5), seeds=[0])
    sensors = np.zeros((1, 1), np.float32)
    for _ in range(60):  # 5 examples have no half, so the root is never cut
        agent.act(sensors)
        agent.observe(sensors)
    assert agent.examples.counts.tolist() == [4]
    assert agent.tree.n_nodes == 1


def test_epsilon_is_the_share_of_random_actions(space: SensorimotorSpace) -> None:
    steps = live(IAC(space, replace(SMALL, epsilon=0.25), seeds=list(range(50))), 100)
    share = torch.stack([step.random_actions for step in steps]).double().mean().item()
    assert share == pytest.approx(0.25, abs=0.025)


def test_without_a_drive_actions_are_uniform(space: SensorimotorSpace) -> None:
    steps = live(IAC(space, replace(SMALL, drive=Random()), seeds=list(range(20))), 100)
    actions = torch.cat([step.actions for step in steps])
    assert actions.mean(dim=0).tolist() == pytest.approx([0.0, 5.0], abs=0.25)
    assert actions.std(dim=0).tolist() == pytest.approx([2 / 12**0.5, 10 / 12**0.5], rel=0.05)


def test_tensors_are_answered_with_tensors(space: SensorimotorSpace) -> None:
    array, tensor = IAC(space, SMALL), IAC(space, SMALL)
    sensors = np.zeros((1, 2), np.float32)
    by_array, by_tensor = array.act(sensors), tensor.act(torch.zeros(1, 2))
    assert isinstance(by_array, np.ndarray)
    assert isinstance(by_tensor, torch.Tensor)
    assert by_array.tolist() == by_tensor.tolist()


def test_what_the_world_does_to_its_buffer_changes_nothing(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL)
    sensors = np.full((1, 2), 0.5, np.float32)
    agent.act(sensors)
    sensors[:] = 1.5
    step = agent.observe(sensors)
    assert step.sensors.tolist() == [[0.5, 0.5]]
    sensors[:] = 0.0
    assert step.outcomes.tolist() == [[1.5]]


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ([[np.nan, 0.0]], r"sensor near must lie in \[0, 2\], got nan from agent 0"),
        ([[0.0, 3.5]], r"sensor far must lie in \[-1, 3\], got 3.5 from agent 0"),
        ([[0.0]], r"sensors must have the shape \(agents, sensors\) = \(1, 2\), got \(1, 1\)"),
    ],
)
def test_bad_sensors_are_refused_and_nothing_is_lost(
    space: SensorimotorSpace, sensors: list[list[float]], message: str
) -> None:
    agent = IAC(space, SMALL)
    good, bad = np.zeros((1, 2), np.float32), np.array(sensors, np.float32)
    with pytest.raises(ValueError, match=message):
        agent.act(bad)
    agent.act(good)
    with pytest.raises(ValueError, match=message):
        agent.observe(bad)
    assert agent.observe(good).number == 0


def test_observing_needs_an_action_first(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL)
    with pytest.raises(RuntimeError, match="observe needs an action to learn from: call act first"):
        agent.observe(np.zeros((1, 2), np.float32))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"epsilon": 1.3}, r"epsilon must lie in \[0, 1\], got 1.3"),
        ({"balance": 0.6}, r"balance must lie in \[0, 0.5\], got 0.6"),
        ({"epsilon": float("nan")}, r"epsilon must lie in \[0, 1\], got nan"),
        ({"n_candidates": 0}, "n_candidates must be at least 1, got 0"),
        ({"max_examples": 1}, "max_examples must be at least 2, got 1"),
        ({"window": 0}, "window must be at least 1, got 0"),
        ({"delay": -3}, "delay must be at least 1, got -3"),
        ({"error": "cubic"}, "error must be absolute or squared, got cubic"),
    ],
)
def test_numbers_out_of_range_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        IACConfig(**values)


def test_agents_need_seeds_and_a_device_that_is_there(space: SensorimotorSpace) -> None:
    with pytest.raises(ValueError, match="seeds must name at least one agent, got none"):
        IAC(space, SMALL, seeds=[])
    with pytest.raises(ValueError, match="device must be"):
        IAC(space, SMALL, device="abacus")
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match="device must be one that this machine has"):
            IAC(space, SMALL, device="cuda")


def test_the_presets_hold_the_papers_numbers() -> None:
    assert PRESETS["iac2004"] == IACConfig()
    of_2007 = PRESETS["iac2007"]
    assert (of_2007.window, of_2007.delay, of_2007.error) == (26, 15, "squared")
