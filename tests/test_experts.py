import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests import oracle
from torch_iac.examples import Examples
from torch_iac.experts import KNNExperts

CPU = torch.device("cpu")


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
