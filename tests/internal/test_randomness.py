import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_iac.internal.randomness import RandomStream

CPU = torch.device("cpu")


def draw(seeds: list[int], n_numbers: int, steps: list[int], stream: int = 0) -> torch.Tensor:
    randomness = RandomStream(seeds, n_numbers, stream, CPU)
    return torch.stack([randomness.at(step) for step in steps])


@given(st.lists(st.integers(-(2**70), 2**70), min_size=1, max_size=4), st.integers(0, 10**6))
def test_numbers_depend_on_the_agents_own_seed_and_the_decision_alone(
    seeds: list[int], step: int
) -> None:
    together = draw(seeds, 5, [step])
    alone = torch.cat([draw([seed], 5, [0, step])[1:] for seed in seeds], dim=1)
    assert torch.equal(together, alone)


def test_more_numbers_leave_the_first_ones_as_they_are() -> None:
    assert torch.equal(draw([3], 7, [300])[..., :4], draw([3], 4, [300]))


def test_numbers_are_uniform_and_independent() -> None:
    numbers = draw([1, 2], 10, list(range(5_000))).double()  # (T, A, n)
    assert numbers.min() >= 0
    assert numbers.max() < 1
    counts = np.histogram(numbers.numpy(), bins=100, range=(0, 1))[0]
    expected = numbers.numel() / 100
    assert ((counts - expected) ** 2 / expected).sum() < 150  # chi square, 99 degrees of freedom
    columns = numbers.flatten(1)
    other = draw([1, 2], 10, list(range(5_000)), stream=1).flatten(1).double()
    correlations = np.corrcoef(torch.cat([columns, other], dim=1).T) - np.eye(40)
    assert np.abs(correlations).max() < 0.065  # 4.6 standard errors


def test_consecutive_seeds_and_decisions_share_no_numbers() -> None:
    numbers = draw(list(range(100)), 10, list(range(100)))
    assert len(np.unique(numbers.numpy())) > 0.99 * numbers.numel()
