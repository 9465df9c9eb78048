"""Bootstrap intervals, against known answers."""

from itertools import product

import numpy as np
import pytest

from torch_iac.analysis.bootstrap import Estimate, band, difference, mean, probability_larger

RNG = np.random.default_rng(3)


def test_the_mean_of_equal_values_is_certain() -> None:
    assert mean(np.full(4, 0.25)) == Estimate(0.25, 0.25, 0.25, 4)


def test_of_two_robots_anything_between_is_possible() -> None:
    # Two draws out of {0, 1}: both are 0, or both are 1, in a quarter of the cases each.
    assert mean(np.array([0.0, 1.0])) == Estimate(0.5, 0.0, 1.0, 2)


@pytest.mark.parametrize("n", [0, 1])
def test_without_two_robots_there_is_no_interval(n: int) -> None:
    found = mean(np.ones(n))
    assert found.n == n
    assert np.isnan([found.low, found.high]).all()
    assert np.isnan(found.value) == (n == 0)


def test_an_interval_of_many_values_is_that_of_the_normal_distribution() -> None:
    values = RNG.normal(size=400)
    found, half = mean(values), 1.96 * values.std() / 20
    assert found.value == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_the_same_values_give_the_same_interval() -> None:
    values = RNG.normal(size=10)
    assert mean(values) == mean(values.copy())


def test_pairing_takes_out_what_pairs_share() -> None:
    values = RNG.normal(size=8)
    found = difference(values + 0.5, values)
    assert [found.value, found.low, found.high] == pytest.approx([0.5, 0.5, 0.5])
    assert found.n == 8


def test_who_is_always_larger_is_so_for_certain() -> None:
    values = RNG.random(6)
    assert probability_larger(values + 2, values) == Estimate(1, 1, 1, 6)
    assert probability_larger(values, values + 2) == Estimate(0, 0, 0, 6)


def test_equal_values_count_half() -> None:
    assert probability_larger(np.zeros(5), np.zeros(5)) == Estimate(0.5, 0.5, 0.5, 5)


def test_the_probability_is_the_share_of_all_pairs() -> None:
    one, other = RNG.integers(0, 5, (2, 9)).astype(np.float64)
    pairs = [(a > b) + 0.5 * (a == b) for a, b in product(one, other)]
    found = probability_larger(one, other)
    assert found.value == pytest.approx(np.mean(pairs))
    assert found.low < found.value < found.high


def test_a_band_holds_the_interval_of_each_row() -> None:
    values = RNG.random((3, 4, 7))
    low, high = band(values)
    assert low.shape == high.shape == (3, 4)
    assert (low < values.mean(axis=-1)).all()
    assert (values.mean(axis=-1) < high).all()
    assert np.isnan(band(values[..., :1])).all()
