import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_iac.regions.examples import NO_EXAMPLE_OUTCOME, Examples
from torch_iac.regions.tree import Split

CPU = torch.device("cpu")


def root_split() -> Split:
    """The split of the only region there is."""
    zero, one = torch.tensor([0]), torch.tensor([1])
    return Split(rows=zero, new_rows=one, agents=zero, left_regions=one, n_rows=2)


def filled(n_examples: int, max_examples: int) -> Examples:
    """One row, whose example i has the situation (i, -i) and the outcome 10 i."""
    examples = Examples(1, 2, 1, max_examples, CPU)
    row = torch.tensor([0])
    for i in range(n_examples):
        examples.add(row, torch.tensor([[float(i), float(-i)]]), torch.tensor([[10.0 * i]]))
    return examples


def held(examples: Examples, row: int) -> list[float]:
    """The first coordinates of the examples of a row, checked against all else it holds."""
    count = int(examples.counts[row])
    firsts = examples.situations[row, 0]
    assert (firsts[count:] == torch.inf).all()
    assert (examples.outcomes[row, 0, count:] == NO_EXAMPLE_OUTCOME).all()
    assert torch.equal(examples.situations[row, 1, :count], -firsts[:count])
    assert torch.equal(examples.outcomes[row, 0, :count], 10 * firsts[:count])
    return firsts[:count].tolist()


def test_examples_are_kept_oldest_first() -> None:
    assert held(filled(3, 5), 0) == [0, 1, 2]


@given(st.lists(st.booleans(), min_size=6, max_size=6))
def test_a_split_parts_the_examples_and_keeps_their_order(goes_right: list[bool]) -> None:
    examples = filled(6, 5)
    examples.split(root_split(), torch.tensor([goes_right]))
    assert held(examples, 0) == [i for i in range(6) if not goes_right[i]]
    assert held(examples, 1) == [i for i in range(6) if goes_right[i]]


def test_forgetting_drops_the_oldest() -> None:
    examples = filled(6, 5)
    examples.forget_oldest(torch.tensor([0]))
    assert held(examples, 0) == [1, 2, 3, 4, 5]
    examples.add(torch.tensor([0]), torch.tensor([[6.0, -6.0]]), torch.tensor([[60.0]]))
    assert held(examples, 0) == [1, 2, 3, 4, 5, 6]
