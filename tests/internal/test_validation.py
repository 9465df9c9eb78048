import pytest

from torch_iac.internal.validation import MAX_COUNT, check_count


@pytest.mark.parametrize("value", [1, MAX_COUNT])
def test_counts_in_their_range_pass(value: int) -> None:
    check_count("k", value)


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (0, "k must be at least 1, got 0"),
        (MAX_COUNT + 1, "k must be at most 1,000,000,000,000, got 1000000000001"),
        (10**400, "k must be at most 1,000,000,000,000, got a number of 401 digits"),
    ],
)
def test_counts_outside_are_refused_in_a_short_sentence(value: int, sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        check_count("k", value)
