"""Intervals: known answers, properties, and how often they leave out the truth.

The levels that are tested here are those of the table in `docs/comparing.md`.
"""

import math
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from torch_iac.analysis.intervals import (
    PART,
    Estimate,
    Values,
    band,
    difference,
    holm,
    in_words,
    mean,
    p_value,
    probability_larger,
    share,
)

Draw = Callable[[np.random.Generator, tuple[int, ...]], Values]

DRAWS: dict[str, tuple[Draw, float]] = {
    "normal": (lambda rng, shape: rng.normal(size=shape), 0.0),
    "skewed": (lambda rng, shape: rng.lognormal(0.0, 0.5, shape), math.exp(0.125)),
    "very skewed": (lambda rng, shape: rng.lognormal(0.0, 1.0, shape), math.exp(0.5)),
    "discrete": (lambda rng, shape: rng.binomial(3, 0.3, shape).astype(np.float64), 0.9),
}
"""What robots' values are drawn from, and its mean."""

SIZES = (3, 5, 10, 30)

MEANS = {
    "normal": (5, 5, 5, 5),
    "skewed": (8, 8, 8, 6),
    "very skewed": (16, 18, 16, 12),
    "discrete": (13, 7, 6, 5),
}
DIFFERENCES = {
    "normal": (5, 5, 5, 5),
    "skewed": (4, 4, 4, 5),
    "very skewed": (3, 3, 3, 4),
    "discrete": (4, 4, 5, 5),
}
PROBABILITIES = {
    "normal": (0, 0, 1, 1),
    "skewed": (0, 0, 1, 1),
    "very skewed": (0, 0, 1, 1),
    "discrete": (0, 0, 0, 0),
}
"""How many of a hundred intervals leave out the truth, for each of `SIZES`."""

numbers = st.lists(st.floats(-100, 100).map(lambda x: round(x, 3)), min_size=2, max_size=12)
pairs = st.lists(
    st.tuples(*[st.floats(-100, 100).map(lambda x: round(x, 3))] * 2), min_size=2, max_size=12
).map(lambda found: np.array(found).T)


def ends(found: Estimate) -> list[float]:
    return [found.value, found.low, found.high]


def misses(low: Values, high: Values, truth: float) -> float:
    """Return how many of a hundred intervals leave out the truth."""
    return 100 * float(np.mean((low > truth) | (high < truth)))


@pytest.mark.parametrize("name", DRAWS)
@pytest.mark.parametrize(("place", "n"), list(enumerate(SIZES)))
def test_levels_are_as_the_page_says(name: str, place: int, n: int) -> None:
    (draw, truth), rng = DRAWS[name], np.random.default_rng(n)
    one, other = draw(rng, (20_000, n)), draw(rng, (20_000, n))
    assert misses(*band(one), truth) == pytest.approx(MEANS[name][place], abs=1)
    assert misses(*band(one - other), 0) == pytest.approx(DIFFERENCES[name][place], abs=1)
    found = [probability_larger(*of) for of in zip(one[:500], other[:500], strict=True)]
    low, high = np.array([(of.low, of.high) for of in found]).T
    assert misses(low, high, 0.5) == pytest.approx(PROBABILITIES[name][place], abs=1)


@pytest.mark.parametrize("n", [*SIZES, 100])
def test_intervals_of_shares_leave_out_the_truth_in_at_most_5_of_100(n: int) -> None:
    found = [share(np.arange(n) < k) for k in range(n + 1)]
    low, high = np.array([(of.low, of.high) for of in found]).T
    for truth in np.linspace(0.001, 0.999, 97):
        is_out = (low > truth) | (high < truth)
        assert stats.binom.pmf(np.arange(n + 1), n, truth)[is_out].sum() <= 0.05


@pytest.mark.parametrize(
    ("truth", "correlation", "spread"),
    [(0.5, -0.5, 1.0), (0.5, 0.8, 1.0), (0.8, 0.0, 20.0), (0.95, 0.0, 20.0), (0.95, -0.5, 1.0)],
)
@pytest.mark.parametrize("n", SIZES)
def test_intervals_of_probabilities_are_wide_enough(
    n: int, truth: float, correlation: float, spread: float
) -> None:
    """Also where pairs are alike or opposed, and where one kind of robots varies more."""
    rng = np.random.default_rng(n)
    other, own = rng.normal(size=(2, 300, n))
    one = spread * (correlation * other + math.sqrt(1 - correlation**2) * own)
    one += stats.norm.ppf(truth) * math.hypot(spread, 1.0)
    found = [probability_larger(*of) for of in zip(one, other, strict=True)]
    low, high = np.array([(of.low, of.high) for of in found]).T
    assert misses(low, high, truth) <= 8  # 5, and what chance adds to 300 cases


def test_a_mean_has_the_interval_of_the_textbook() -> None:
    # The table says t = 2.776 for four degrees of freedom; the standard error is 0.5 ** 0.5.
    found = mean(np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    half = 2.776 * math.sqrt(0.5)
    assert ends(found) == pytest.approx([3, 3 - half, 3 + half], abs=1e-3)
    assert found.n == 5


def test_a_difference_is_that_of_the_pairs() -> None:
    one, other = np.array([3.0, 5.0, 9.0, 4.0]), np.array([1.0, 5.0, 6.0, 4.0])
    assert ends(difference(one, other)) == ends(mean(one - other))
    assert p_value(one, other) == pytest.approx(stats.ttest_rel(one, other).pvalue)


def test_an_interval_goes_no_further_than_values_can() -> None:
    found = mean(np.array([0.0, 0.1, 0.9]), PART)
    assert (found.low, found.high) == (0.0, 1.0)
    low, high = band(np.array([[0.0, 0.1, 0.9]]), PART)
    assert (low.tolist(), high.tolist()) == ([0.0], [1.0])


@given(numbers, st.floats(0.1, 10), st.floats(-100, 100))
def test_means_are_shifted_and_scaled_with_the_values(
    found: list[float], scale: float, shift: float
) -> None:
    values = np.array(found)
    expected = [scale * end + shift for end in ends(mean(values))]
    assert ends(mean(scale * values + shift)) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(pairs, st.floats(0.1, 10), st.floats(-100, 100))
def test_differences_do_not_see_a_shift_of_both(found: Values, scale: float, shift: float) -> None:
    one, other = found
    expected = [scale * end for end in ends(difference(one, other))]
    shifted = difference(scale * one + shift, scale * other + shift)
    assert ends(shifted) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(pairs)
def test_swapping_turns_the_sign_of_a_difference(found: Values) -> None:
    one, other = found
    value, low, high = ends(difference(one, other))
    assert ends(difference(other, one)) == pytest.approx([-value, -high, -low])
    assert p_value(one, other) == pytest.approx(p_value(other, one))


@given(pairs)
def test_swapping_gives_the_other_probability(found: Values) -> None:
    one, other = found
    value, low, high = ends(probability_larger(one, other))
    assert ends(probability_larger(other, one)) == pytest.approx([1 - value, 1 - high, 1 - low])
    assert 0 <= low < high <= 1


@given(pairs)
def test_the_probability_is_the_share_of_all_pairs_in_any_scale(found: Values) -> None:
    one, other = found
    expected = np.mean([(a > b) + 0.5 * (a == b) for a, b in product(one, other)])
    assert probability_larger(one, other).value == pytest.approx(expected)
    assert probability_larger(np.exp(one / 50), np.exp(other / 50)).value == pytest.approx(expected)


@given(st.lists(st.booleans(), min_size=1, max_size=20))
def test_those_that_did_not_are_the_other_share(found: list[bool]) -> None:
    value, low, high = ends(share(np.array(found)))
    assert ends(share(~np.array(found))) == pytest.approx([1 - value, 1 - high, 1 - low])


@given(pairs.filter(lambda found: np.ptp(found[0] - found[1]) > 0.01))
def test_the_interval_leaves_out_0_where_p_is_below_5_percent(found: Values) -> None:
    by = difference(*found)
    assert (by.low > 0 or by.high < 0) == (p_value(*found) < 0.05)


def test_all_of_ten_robots_are_not_all_robots() -> None:
    # Of robots of which 69 % do it, ten do in 2.5 cases of a hundred: 0.69 ** 10.
    assert ends(share(np.ones(10, np.bool_))) == pytest.approx([1, 0.025**0.1, 1])
    ten = np.arange(10.0)
    assert ends(probability_larger(ten + 20, ten)) == pytest.approx([1, 0.025**0.1, 1])
    assert ends(probability_larger(ten, ten + 20)) == pytest.approx([0, 0, 1 - 0.025**0.1])


@pytest.mark.parametrize("value", [0.0, 0.1, 250.0, -1e-9])
def test_the_mean_of_equal_values_is_that_value(value: float) -> None:
    values = np.full(7, value)
    assert mean(values) == Estimate(value, value, value, 7)
    assert [end.tolist() for end in band(np.stack([values, values]))] == [[value] * 2] * 2


def test_rounding_does_not_make_a_spread() -> None:
    values = np.random.default_rng(0).normal(size=8)
    by = difference(values + 0.1, values)
    assert by.low == by.value == by.high == pytest.approx(0.1)
    assert p_value(values + 0.1, values) == 2 / 2**8  # the sign test's
    assert p_value(values, values) == 1


@pytest.mark.parametrize("n", [0, 1])
def test_without_two_robots_there_is_no_interval(n: int) -> None:
    for found in (mean(np.ones(n)), difference(np.ones(n), np.zeros(n))):
        assert found.n == n
        assert np.isnan([found.low, found.high]).all()
        assert np.isnan(found.value) == (n == 0)
    assert math.isnan(p_value(np.ones(n), np.zeros(n)))
    assert np.isnan(band(np.ones((3, n)))).all()


def test_of_no_robots_there_is_no_share() -> None:
    for found in (share(np.ones(0, np.bool_)), probability_larger(np.ones(0), np.ones(0))):
        assert found.n == 0
        assert np.isnan(ends(found)).all()


def test_a_band_holds_the_interval_of_each_row() -> None:
    values = np.random.default_rng(1).random((3, 4, 7))
    low, high = band(values)
    for place in np.ndindex(3, 4):
        found = mean(values[place])
        assert (low[place], high[place]) == pytest.approx((found.low, found.high))


def test_holm_multiplies_by_how_many_are_left() -> None:
    found = holm(np.array([0.01, np.nan, 0.04, 0.03, 0.005, 0.9]))
    assert found == pytest.approx([0.04, np.nan, 0.09, 0.09, 0.025, 0.9], nan_ok=True)
    assert holm(np.array([])).tolist() == []


@given(st.lists(st.floats(0, 1), max_size=8))
def test_adjusted_values_keep_their_order_and_never_fall(found: list[float]) -> None:
    p_values = np.array(found, dtype=np.float64)
    adjusted = holm(p_values)
    assert ((p_values <= adjusted) & (adjusted <= 1)).all()
    assert (np.diff(adjusted[np.argsort(p_values)]) >= 0).all()


@pytest.mark.parametrize("n", [5, 10])
def test_a_table_without_a_difference_seldom_shows_one(n: int) -> None:
    """Of 20 measures that share something; without the correction, four of ten tables would."""
    rng = np.random.default_rng(n)
    values = rng.normal(size=(1000, 20, n)) + 0.5 * rng.normal(size=(1000, 1, n))
    p_values = stats.ttest_1samp(values, 0, axis=-1).pvalue
    assert (p_values < 0.05).any(axis=1).mean() > 0.4
    assert np.mean([(holm(of) < 0.05).any() for of in p_values]) < 0.065


@pytest.mark.parametrize(
    ("found", "percent", "text"),
    [
        (Estimate(0.9996, 0.9994, 0.9998, 9), False, "0.99960 (0.99940 to 0.99980)"),
        (Estimate(1234.5, 1100.2, 1400.4, 9), False, "1,234 (1,100 to 1,400)"),
        (Estimate(0.5, 0.0, 1.0, 9), False, "0.5 (0.0 to 1.0)"),
        (Estimate(-0.0004, -0.013, 0.012, 9), False, "0.000 (-0.013 to 0.012)"),
        (Estimate(1.0, 0.692, 1.0, 10), True, "100% (69% to 100%)"),
        (Estimate(2e-12, 1e-12, 3e-12, 9), False, "2.00e-12 (1.00e-12 to 3.00e-12)"),
        (Estimate(0.25, 0.25, 0.25, 9), False, "0.25 in all"),
        (Estimate(1.0, 1.0, 1.0, 9), True, "100% in all"),
        (Estimate(0.25, math.nan, math.nan, 1), False, "0.25"),
        (Estimate(math.nan, math.nan, math.nan, 0), False, "none"),
    ],
)
def test_a_number_is_written_as_exactly_as_it_is_known(
    found: Estimate, percent: bool, text: str
) -> None:
    assert in_words(found, percent) == text


@given(st.floats(-1e6, 1e6), st.floats(1e-7, 1e6))
def test_the_ends_that_are_written_are_never_the_same(value: float, half: float) -> None:
    text = in_words(Estimate(value, value - half, value + half, 5))
    low, high = text.partition("(")[2].rstrip(")").split(" to ")
    assert low != high
