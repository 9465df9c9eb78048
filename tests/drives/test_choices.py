import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torch_iac.drives.choices import Choice, Greedy, Proportional, Softmax

N_NUMBERS = 10_000
NUMBERS = (torch.arange(N_NUMBERS) / N_NUMBERS).float()
"""All that chance can be, finely: how often a candidate is taken is then its probability."""

CHOICES: list[Choice] = [Greedy(), Proportional(), Softmax()]


def probabilities(choice: Choice, worth: list[float]) -> list[float]:
    table = torch.tensor(worth, dtype=torch.float64).expand(N_NUMBERS, -1)
    chosen = choice.pick(table, NUMBERS)
    shares: list[float] = (chosen.bincount(minlength=len(worth)) / N_NUMBERS).tolist()
    return shares


def close(values: list[float]) -> object:
    return pytest.approx(values, abs=2 / N_NUMBERS)


@pytest.mark.parametrize("choice", CHOICES)
def test_each_is_a_choice(choice: Choice) -> None:
    assert isinstance(choice, Choice)


def test_greedy_takes_the_best_and_of_equals_the_first() -> None:
    assert probabilities(Greedy(), [0.1, 0.3, -1.0, 0.3]) == [0, 1, 0, 0]
    assert probabilities(Greedy(), [-2.0, -1.0, -1.5]) == [0, 1, 0]


@pytest.mark.parametrize(
    ("worth", "expected"),
    [
        ([0.1, 0.3, 0.4, 0.2], [0.1, 0.3, 0.4, 0.2]),
        ([3e-9, 1e-9], [0.75, 0.25]),
        ([1.0, -5.0, 1.0], [0.5, 0.0, 0.5]),
        ([0.0, -1.0, 2.0, 0.0], [0.0, 0.0, 1.0, 0.0]),
        ([-0.5, -0.1, 0.0, -2.0], [0.25] * 4),
        ([0.0] * 5, [0.2] * 5),
        ([1.0, math.inf, 0.0, math.inf], [0.0, 0.5, 0.0, 0.5]),
        ([-math.inf, 1.0, 1.0], [0.0, 0.5, 0.5]),
        ([7.0], [1.0]),
    ],
)
def test_proportional(worth: list[float], expected: list[float]) -> None:
    assert probabilities(Proportional(), worth) == close(expected)


@pytest.mark.parametrize(
    ("temperature", "worth", "expected"),
    [
        (1.0, [0.0, math.log(2), math.log(5)], [0.125, 0.25, 0.625]),
        (0.01, [-0.02, -0.02 + 0.01 * math.log(3)], [0.25, 0.75]),
        (0.01, [0.0] * 4, [0.25] * 4),
        (1e9, [0.0, 1.0, -3.0, 2.0], [0.25] * 4),
        (1e-6, [0.1, 0.3, 0.3, 0.2], [0.0, 0.5, 0.5, 0.0]),
        (5e-324, [0.1, 0.3, 0.3, 0.2], [0.0, 0.5, 0.5, 0.0]),
        (5e-324, [-0.3, -0.1], [0.0, 1.0]),
        (1.0, [1e6, 1e6 - math.log(3)], [0.75, 0.25]),
        (1.0, [1.0, math.inf, math.inf, 0.0, math.inf], [0, 1 / 3, 1 / 3, 0, 1 / 3]),
        (1.0, [-math.inf, 0.0], [0.0, 1.0]),
    ],
)
def test_softmax(temperature: float, worth: list[float], expected: list[float]) -> None:
    assert probabilities(Softmax(temperature), worth) == close(expected)


def test_each_agent_has_its_own_worth_and_its_own_chance() -> None:
    worth = torch.tensor([[1.0, 0.0], [1.0, math.inf], [1.0, 1.0], [1.0, 1.0]]).double()
    numbers = torch.tensor([0.99, 0.0, 0.49, 0.5])
    for choice in (Proportional(), Softmax(0.1)):
        assert choice.pick(worth, numbers).tolist() == [0, 1, 0, 1]
    assert Greedy().pick(worth, numbers).tolist() == [0, 1, 0, 0]


@given(
    st.lists(st.floats(allow_nan=False, width=32), min_size=1, max_size=6),
    st.integers(0, 2**23 - 1),
)
def test_what_is_taken_is_a_candidate_and_never_one_worth_less_than_nothing_beside_a_good_one(
    worth: list[float], number: int
) -> None:
    table: Tensor = torch.tensor([worth], dtype=torch.float64)
    numbers = torch.tensor([number * 2.0**-23])
    picks = [choice.pick(table, numbers).item() for choice in CHOICES]
    assert all(0 <= pick < len(worth) for pick in picks)
    assert worth[int(picks[0])] == max(worth)
    if max(worth) > 0:
        assert worth[int(picks[1])] > 0


@pytest.mark.parametrize("temperature", [0.0, -1.0, math.inf, math.nan])
def test_a_temperature_is_above_nothing_and_finite(temperature: float) -> None:
    with pytest.raises(
        ValueError, match=f"temperature must be above 0 and finite, got {temperature}"
    ):
        Softmax(temperature)
