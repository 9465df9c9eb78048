"""A population that is saved and loaded goes on as if nothing had happened, to the bit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from tests.test_agent import DRIVES, LEARNERS, SMALL, Pendulum
from torch_iac import (
    IAC,
    Choice,
    Drive,
    Error,
    Experts,
    Greedy,
    IACConfig,
    KNNExperts,
    MetaPredictor,
    MLPExperts,
    NetworkExperts,
    Progress,
    Proportional,
    SensorimotorSpace,
    Softmax,
    Stateful,
    Step,
)
from torch_iac.regions.examples import Examples
from torch_iac.regions.tree import Split


class Residual(nn.Module):
    """No plain stack of layers, so it runs through vmap."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.straight, self.bent = nn.Linear(n_inputs, n_outputs), nn.Linear(n_inputs, 6)
        self.out = nn.Linear(6, n_outputs, bias=False)

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.straight(inputs) + self.out(torch.tanh(self.bent(inputs)))
        return outputs


@dataclass(frozen=True)
class Means:
    """Experts made by a user: the mean of all outcomes that a region ever learnt from."""

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "MeanPool":
        """Return the experts of a population."""
        del situation_dim, device
        return MeanPool(torch.zeros(len(seeds), outcome_dim + 1))


class MeanPool(Stateful):
    """Grows by exactly what it needs."""

    saved = ("version",)
    tables = {"n_rows": ("sums",)}  # noqa: RUF012 - as a user may well write it

    def __init__(self, sums: Tensor) -> None:
        self.sums, self.n_rows, self.version = sums, len(sums), 1

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:  # noqa: ARG002
        sums = self.sums[rows]
        return sums[:, 1:] / sums[:, :1].clamp(min=1)

    def learn(self, examples: Examples, rows: Tensor, step: int) -> None:  # noqa: ARG002
        newest = examples.outcomes[rows, :, examples.counts[rows] - 1]
        self.sums[rows] += torch.cat([torch.ones(len(rows), 1), newest], dim=1)

    def split(self, examples: Examples, split: Split) -> None:  # noqa: ARG002
        self.n_rows = split.n_rows
        self.sums = torch.cat([self.sums, self.sums[split.rows]])


class Forgetful:
    """Experts that cannot be saved."""

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "Forgetful":
        """Return itself."""
        del situation_dim, outcome_dim, seeds, device
        return self

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:  # noqa: ARG002
        return torch.zeros(len(rows), 1)

    def learn(self, examples: Examples, rows: Tensor, step: int) -> None:
        pass

    def split(self, examples: Examples, split: Split) -> None:
        pass


def goes_on_as_before(
    space: SensorimotorSpace, config: IACConfig, seeds: list[int], stops: list[int], n: int
) -> IAC:
    """Check it at each stop of a run of `n` decisions, and return who lived it."""
    agent, world = IAC(space, config, seeds), Pendulum(seeds)
    readings, states, steps = [world.reset()], [], []
    for number in range(n):
        if number in stops:
            states.append(agent.state())
        readings.append(world.step(agent.act(readings[-1])))
        steps.append(agent.observe(readings[-1]))
    for number, state in zip(stops, states, strict=True):
        again = IAC(space, config, seeds)
        again.load_state(state)
        assert again.n_decisions == number
        for step, (before, after) in zip(steps[number:], pairwise(readings[number:]), strict=True):
            again.act(before)
            assert_equal(again.observe(after), step)
        assert_same_state(again, agent)
    return agent


def assert_equal(one: Step, other: Step) -> None:
    for name, value in vars(one).items():
        if isinstance(value, Tensor):
            assert torch.equal(value, getattr(other, name)), (one.number, name)
        elif name != "shadows":
            assert value == getattr(other, name), name
    for shadow, other_shadow in zip(one.shadows, other.shadows, strict=True):
        assert shadow.name == other_shadow.name
        assert torch.equal(shadow.predictions, other_shadow.predictions), shadow.name
        assert torch.equal(shadow.errors, other_shadow.errors), shadow.name


def assert_same_state(one: IAC, other: IAC) -> None:
    """Not even how far tables have grown in advance tells the two apart."""
    state, other_state = one.state(), other.state()
    assert state.keys() == other_state.keys()
    for name, tensor in state.items():
        assert tensor.numpy().tobytes() == other_state[name].numpy().tobytes(), name


SHADOWS: dict[str, Experts] = {
    "knn": KNNExperts(),
    "mlp": MLPExperts(hidden=(8,), minibatches=1),
    "mlp/deep": MLPExperts(hidden=(4, 4), minibatches=1, optimizer="sgd"),
    "means": Means(),
}


@pytest.mark.parametrize(
    ("config", "n_decisions"),
    [
        (SMALL, 300),
        (replace(SMALL, experts=KNNExperts(k=3), inherit_history=False), 200),
        (replace(SMALL, error="squared", window=6, delay=3, balance=0.0, epsilon=0.15), 200),
        (replace(SMALL, experts=MLPExperts(minibatches=2), meta=MetaPredictor()), 90),
        (
            replace(SMALL, experts=MLPExperts(hidden=(8,), children="fresh", fresh_minibatches=5)),
            90,
        ),
        (replace(SMALL, experts=NetworkExperts(module=Residual, minibatches=1)), 90),
        (replace(SMALL, experts=Means()), 90),
        (replace(SMALL, shadows=SHADOWS), 90),
        (replace(SMALL, meta=MetaPredictor(memory=30), max_examples=10), 90),
    ],
    ids=["1-nn", "3-nn", "2007", "MLPs", "fresh MLPs", "a module", "a user's", "shadows", "MP"],
)
def test_every_kind_of_expert_goes_on_across_splits_and_growth(
    space: SensorimotorSpace, config: IACConfig, n_decisions: int
) -> None:
    stops = [0, 20, 21, n_decisions - 40]
    agent = goes_on_as_before(space, config, [3, 1, 2], stops, n_decisions)
    assert agent.tree.n_rows > 6  # the tables grew at least twice


@pytest.mark.parametrize(
    ("drive", "choice"),
    [*((drive, Greedy()) for drive in DRIVES), (Progress(), Softmax()), (Error(), Proportional())],
    ids=repr,
)
def test_every_drive_and_choice_goes_on(
    space: SensorimotorSpace, drive: Drive, choice: Choice
) -> None:
    config = replace(LEARNERS, drive=drive, choice=choice)
    goes_on_as_before(space, config, [0, 7], [30], 45)


def test_a_state_is_a_copy(space: SensorimotorSpace) -> None:
    agent = IAC(space, LEARNERS, [0])
    state = agent.state()
    kept = {name: tensor.clone() for name, tensor in state.items()}
    again = IAC(space, LEARNERS, [0])
    again.load_state(state)
    for robot in (agent, again):
        for _ in range(30):
            robot.act(np.zeros((1, 2), np.float32))
            robot.observe(np.ones((1, 2), np.float32))
    for name, tensor in state.items():
        assert tensor.numpy().tobytes() == kept[name].numpy().tobytes(), name


def test_a_state_lies_between_two_decisions(space: SensorimotorSpace) -> None:
    agent = IAC(space, SMALL)
    state = agent.state()
    agent.act(np.zeros((1, 2), np.float32))
    with pytest.raises(RuntimeError, match="a state lies between two decisions: call observe"):
        agent.state()
    agent.load_state(state)
    with pytest.raises(RuntimeError, match="call act first"):
        agent.observe(np.zeros((1, 2), np.float32))


@pytest.mark.parametrize(
    ("config", "name"),
    [
        (replace(SMALL, experts=Forgetful()), "experts"),
        (replace(SMALL, shadows={"mine": Forgetful()}), "shadows/mine"),
    ],
)
def test_experts_that_cannot_be_saved_are_named(
    space: SensorimotorSpace, config: IACConfig, name: str
) -> None:
    rule = f"{name} must have the methods state and load_state to be saved, got Forgetful without"
    with pytest.raises(TypeError, match=rule):
        IAC(space, config).state()


@pytest.mark.parametrize(
    ("name", "tensor", "message"),
    [
        ("tree/parent", None, "tree/parent must be in the state, got none"),
        (
            "tree/parent",
            torch.zeros(1),
            r"tree/parent must be torch.int64 of shape \(1,\), got torch.float32 of shape \(1,\)",
        ),
        (
            "experts/networks/weights",
            torch.zeros(2, 41),
            r"experts/networks/weights must be torch.float32 of shape \(1, 49\), "
            r"got torch.float32 of shape \(2, 41\)",
        ),
        ("tree/n_nodes", torch.tensor(-1), "tree/n_nodes must be at least 0, got -1"),
        ("meta/mood", torch.zeros(1), "meta/mood must not be in the state"),
    ],
)
def test_a_state_that_does_not_fit_is_refused(
    space: SensorimotorSpace, name: str, tensor: Tensor | None, message: str
) -> None:
    state = IAC(space, LEARNERS).state() | ({} if tensor is None else {name: tensor})
    if tensor is None:
        del state[name]
    with pytest.raises(ValueError, match=message):
        IAC(space, LEARNERS).load_state(state)
