from dataclasses import dataclass
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from tests import oracle
from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.network import MLPExperts, NetworkExperts
from torch_iac.experts.protocol import ExpertPool, Experts
from torch_iac.regions.examples import Examples
from torch_iac.regions.tree import Split

CPU = torch.device("cpu")
ROOT = torch.tensor([0])
CUT = Split(
    rows=ROOT, new_rows=torch.tensor([1]), agents=ROOT, left_regions=torch.tensor([1]), n_rows=2
)
"""The root of the only agent is cut in two."""


def remember(situations: list[list[float]], outcomes: list[list[float]]) -> Examples:
    examples = Examples(1, len(situations[0]), len(outcomes[0]), 20, CPU)
    for situation, outcome in zip(situations, outcomes, strict=True):
        examples.add(torch.tensor([0]), torch.tensor([situation]), torch.tensor([outcome]))
    return examples


def predict(k: int, examples: Examples, situation: list[float]) -> list[float]:
    prediction = KNNExperts(k).predict(examples, torch.tensor([0]), torch.tensor([situation]))
    values: list[float] = prediction[0].tolist()
    return values


@pytest.mark.parametrize("k", [1, 3])
def test_without_examples_the_prediction_is_the_middle_of_the_scale(k: int) -> None:
    assert predict(k, Examples(1, 2, 2, 20, CPU), [0.1, 0.2]) == [0.5, 0.5]


def test_known_answers() -> None:
    examples = remember([[0.0], [1.0], [0.5]], [[0.0], [1.0], [0.25]])
    assert predict(1, examples, [0.9]) == [1.0]
    assert predict(2, examples, [0.1]) == [0.125]
    assert predict(5, examples, [0.1]) == pytest.approx([1.25 / 3])


def test_ties_go_to_the_oldest() -> None:
    examples = remember([[0.25], [0.75], [0.25]], [[1.0], [2.0], [3.0]])
    assert predict(1, examples, [0.5]) == [1.0]
    assert predict(2, examples, [0.5]) == [1.5]


@given(st.data(), st.integers(1, 4))
def test_predictions_are_the_oracles(data: st.DataObject, k: int) -> None:
    coordinates = st.integers(0, 16).map(lambda i: i / 16)  # exact, with many ties
    points = st.lists(coordinates, min_size=3, max_size=3)
    situations = data.draw(st.lists(points, min_size=1, max_size=20))
    outcomes = [[data.draw(coordinates), 1.0] for _ in situations]
    query = data.draw(points)
    robot = oracle.Robot(k=k)
    robot.root.examples = list(zip(situations, outcomes, strict=True))
    expected = robot.predict(robot.root, query)
    assert predict(k, remember(situations, outcomes), query) == pytest.approx(expected, abs=1e-6)


def test_bad_k_is_refused() -> None:
    with pytest.raises(ValueError, match="k must be at least 1, got 0"):
        KNNExperts(0)


def uniform(n: int, seed: int = 0) -> Tensor:
    return torch.rand(n, 2, generator=torch.Generator().manual_seed(seed))


def linear(situations: Tensor) -> Tensor:
    """What the world does: one outcome, between 0.1 and 0.9."""
    return 0.3 + situations @ torch.tensor([[0.6], [-0.2]])


def lived(experts: Experts, outcomes_of: Any, n: int = 150) -> tuple[ExpertPool, Examples]:
    """Experts of one agent whose root has just been filled, and the examples."""
    pool, examples = experts.pool(2, 1, [0], CPU), Examples(1, 2, 1, n - 1, CPU)
    for step, situation in enumerate(uniform(n)):
        examples.add(ROOT, situation[None], outcomes_of(situation[None]))
        pool.learn(examples, ROOT, step)
    return pool, examples


def asked(pool: ExpertPool, examples: Examples, row: int, situations: Tensor) -> Tensor:
    row_of_each = torch.tensor([row])
    return torch.cat([pool.predict(examples, row_of_each, one[None]) for one in situations])


class Straight(nn.Module):
    """A user's own module: a line, and nothing that torch calls a layer."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.slope = nn.Parameter(torch.randn(n_inputs, n_outputs) / 10)
        self.start = nn.Parameter(torch.zeros(n_outputs))

    def forward(self, situations: Tensor) -> Tensor:
        return situations @ self.slope + self.start


NETWORKS = [
    MLPExperts(),
    MLPExperts(hidden=(), learning_rate=0.03),
    MLPExperts(hidden=(16,), optimizer="sgd", learning_rate=0.2),
    NetworkExperts(module=Straight, learning_rate=0.03),
    NetworkExperts(learning_rate=0.005),
]


@pytest.mark.parametrize("experts", [KNNExperts(), *NETWORKS])
def test_each_kind_is_experts(experts: Experts) -> None:
    assert isinstance(experts, Experts)


@pytest.mark.parametrize("experts", NETWORKS)
def test_a_network_learns_a_linear_world(experts: Experts) -> None:
    pool, examples = lived(experts, linear)
    new = uniform(50, seed=1)
    untaught = asked(experts.pool(2, 1, [0], CPU), examples, 0, new)
    assert (untaught - linear(new)).abs().mean() > 0.1
    assert (asked(pool, examples, 0, new) - linear(new)).abs().mean() < 0.03


def test_mlp_experts_are_network_experts_with_the_default_module() -> None:
    new = uniform(20, seed=1)
    mlp, network = (asked(*lived(e, linear, 20), 0, new) for e in (MLPExperts(), NetworkExperts()))
    assert torch.equal(mlp, network)


def test_children_start_as_copies_of_their_parent() -> None:
    pool, examples = lived(MLPExperts(), linear)
    new = uniform(20, seed=1)
    before = asked(pool, examples, 0, new)
    examples.split(CUT, examples.situations[:1, 0] > 0.5)
    pool.split(examples, CUT)
    for child in (0, 1):
        assert torch.equal(asked(pool, examples, child, new), before)


def test_fresh_children_know_what_they_inherit_and_nothing_else() -> None:
    def step_at_half(situations: Tensor) -> Tensor:
        return torch.where(situations[:, :1] > 0.5, 0.9, 0.1)

    experts = MLPExperts(children="fresh", hidden=(8,), minibatches=1)
    pool, examples = lived(experts, step_at_half)
    examples.split(CUT, examples.situations[:1, 0] > 0.5)
    pool.split(examples, CUT)
    everywhere = uniform(50, seed=1)  # a child has seen one side only, and answers so on both
    for child, outcome in ((0, 0.1), (1, 0.9)):
        errors = asked(pool, examples, child, everywhere) - outcome
        assert errors.abs().mean() < 0.05


def test_a_fresh_child_depends_on_its_birth_and_not_on_its_parents_weights() -> None:
    new, answers = uniform(20, seed=1), []
    for n_minibatches in (1, 8):  # parents that learnt differently from the same examples
        experts = MLPExperts(children="fresh", fresh_minibatches=0, minibatches=n_minibatches)
        pool, examples = lived(experts, linear, 30)
        parent = asked(pool, examples, 0, new)
        examples.split(CUT, examples.situations[:1, 0] > 0.5)
        pool.split(examples, CUT)
        answers.append((parent, asked(pool, examples, 0, new), asked(pool, examples, 1, new)))
    (parent, left, right), (other_parent, other_left, other_right) = answers
    assert not torch.equal(parent, other_parent)
    assert torch.equal(left, other_left)
    assert torch.equal(right, other_right)
    assert not torch.equal(left, right)
    assert not torch.equal(left, parent)


@pytest.mark.parametrize("children", ["copy", "fresh"])
def test_a_network_learns_from_the_examples_of_its_region_alone(children: Any) -> None:
    answers = []
    for elsewhere in (0.2, 0.7):  # what happens in the right region
        pool, examples = lived(MLPExperts(children=children, hidden=(8,)), linear, 40)
        examples.split(CUT, examples.situations[:1, 0] > 0.5)
        pool.split(examples, CUT)
        for step, situation in enumerate(uniform(20, seed=2), start=40):
            row = (situation[:1] > 0.5).long()
            outcome = torch.where(situation[:1] > 0.5, elsewhere, 0.4)[None]
            examples.add(row, situation[None], outcome)
            pool.learn(examples, row, step)
        answers.append([asked(pool, examples, row, uniform(20, seed=1)) for row in (0, 1)])
    (left, right), (same_left, other_right) = answers
    assert torch.equal(left, same_left)
    assert not torch.allclose(right, other_right, atol=0.1)


def test_agents_start_with_networks_of_their_own() -> None:
    pool = MLPExperts().pool(2, 1, [0, 1, 256, 2**32], CPU)
    rows, same = torch.arange(4), torch.full((4, 2), 0.5)
    answers = pool.predict(Examples(4, 2, 1, 20, CPU), rows, same)[:, 0].tolist()
    assert len(set(answers)) == 4


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"children": "clone"}, "children must be copy or fresh, got clone"),
        ({"fresh_minibatches": -1}, "fresh_minibatches must be at least 0, got -1"),
        ({"learning_rate": -0.1}, "learning_rate must be above 0, got -0.1"),
        ({"hidden": (0,)}, r"hidden must be at least 1 unit a layer, got \(0,\)"),
    ],
)
def test_bad_numbers_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MLPExperts(**values)


def test_a_bad_module_is_refused_when_the_agent_is_made() -> None:
    @dataclass(frozen=True)
    class Twisted:
        def __call__(self, n_inputs: int, n_outputs: int) -> nn.Module:
            return nn.Linear(n_inputs, n_outputs + 1)

    experts = NetworkExperts(module=Twisted())
    with pytest.raises(ValueError, match=r"situations \(n, 2\) into outcomes \(n, 1\), got"):
        experts.pool(2, 1, [0], CPU)
