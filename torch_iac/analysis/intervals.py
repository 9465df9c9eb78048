"""Means, differences, shares and probabilities of improvement, with intervals of 95 %.

Their level holds with few robots too: Student's t for means and for differences of pairs, Clopper
and Pearson's interval for shares of robots and for the probability of improvement.
`docs/comparing.md` says how often they leave out the truth.

Sources: Student (1908), "The Probable Error of a Mean"; Clopper and Pearson (1934), "The Use of
Confidence or Fiducial Limits Illustrated in the Case of the Binomial"; Holm (1979), "A Simple
Sequentially Rejective Multiple Test Procedure".
"""

# scipy is imported where it is used: its statistics take a second, and most runs have one robot.

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEVEL = 0.95
"""How often an interval holds the true value."""

SAME = 1e-12
"""Values that differ by less, beside the largest of them, are equal but for rounding."""

MOST_DECIMALS = 8
"""Smaller numbers are written as powers of ten."""

ANY = (-math.inf, math.inf)
PART = (0.0, 1.0)
POSITIVE = (0.0, math.inf)
"""Where values can lie: anywhere; if they are parts of a whole; if they are sizes or times."""

Range = tuple[float, float]
Values = NDArray[np.float64]
"""One number for each robot along the last axis, in any units."""


@dataclass(frozen=True)
class Estimate:
    """A number and its interval.

    Attributes:
        value: The number; NaN without robots.
        low: The lower end of its interval; NaN where there is none, as of the mean of one robot.
        high: The upper end. Both are the number itself if all robots have the same.
        n: Number of robots, or of pairs of robots.
    """

    value: float
    low: float
    high: float
    n: int


def mean(values: Values, within: Range = ANY) -> Estimate:
    """Return the mean of values, shape `(n,)`, with Student's interval.

    Args:
        values: The values.
        within: Where such values can lie; the interval goes no further.

    Example:
        >>> found = mean(np.array([1.0, 2.0, 3.0]))
        >>> f"{found.value} ({found.low:.3f} to {found.high:.3f})"
        '2.0 (-0.484 to 4.484)'
    """
    return _estimate(values, _size(values), within)


def difference(one: Values, other: Values) -> Estimate:
    """Return how much larger the mean of the one is, robots being paired; both of shape `(n,)`.

    Student's interval, of the mean of the pairs' differences.
    """
    return _estimate(one - other, np.maximum(_size(one), _size(other)), ANY)


def p_value(one: Values, other: Values) -> float:
    """Return how probable so large a difference of pairs is where there is none in truth.

    Two-sided, by Student's t test of the pairs. If all pairs differ by the same, which leaves
    nothing to compare the difference with, by the sign test. NaN with less than two pairs.
    """
    from scipy.stats import ttest_1samp

    n = len(one)
    if n < 2:
        return math.nan
    found = difference(one, other)
    if found.low < found.high:
        return float(ttest_1samp(one - other, 0).pvalue)
    return 1.0 if found.value == 0 else 2.0 ** (1 - n)


def share(happened: NDArray[np.bool_]) -> Estimate:
    """Return which share of robots did something, with Clopper and Pearson's interval.

    Args:
        happened: Whether each did, shape `(n,)`.

    Example:
        >>> found = share(np.ones(10, np.bool_))
        >>> f"{found.value} ({found.low:.2f} to {found.high:.2f})"
        '1.0 (0.69 to 1.00)'
    """
    return _share(float(happened.sum()), len(happened))


def probability_larger(one: Values, other: Values) -> Estimate:
    """Return how probably a robot of the one has a larger value than one of the other.

    Equal values count half. It is Mann and Whitney's U as a share of all pairs. Whatever the values
    are drawn from, it varies at most as much as a share of `n` robots, and has the interval of one:
    that all are larger does not make it certain.

    Args:
        one: Shape `(n,)`.
        other: Shape `(n,)`.

    Example:
        >>> found = probability_larger(np.array([2.0, 3.0, 5.0]), np.array([1.0, 2.0, 4.0]))
        >>> f"{found.value:.3f} ({found.low:.3f} to {found.high:.3f})"
        '0.722 (0.119 to 0.996)'

    Source: Birnbaum and Klose (1957), "Bounds for the Variance of the Mann-Whitney Statistic".
    """
    from scipy.stats import rankdata

    n = len(one)
    ranks = rankdata(np.concatenate([one, other]))[:n]
    return _share(float(ranks.sum() - n * (n + 1) / 2) / max(n, 1), n)


def band(values: Values, within: Range = ANY) -> tuple[Values, Values]:
    """Return the ends of the intervals of means over the last axis, shape `(..., n)`."""
    if values.shape[-1] < 2:
        nothing = np.full(values.shape[:-1], np.nan)
        return nothing, nothing
    return _student(values, _size(values), within)[1:]


def holm(p_values: Values) -> Values:
    """Return p-values adjusted for how many they are, shape `(m,)`; NaN stays, and does not count.

    The chance that any of those that are below 0.05 is a difference where there is none in truth
    is then at most 5 %, however the values depend on one another.
    """
    known = np.flatnonzero(np.isfinite(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    adjusted = np.full(len(p_values), np.nan)
    steps = p_values[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


def in_words(found: Estimate, percent: bool = False) -> str:
    """Return a number and its interval, with as many digits as the interval's width bears.

    Example:
        >>> in_words(Estimate(0.05041, 0.04893, 0.05187, 100))
        '0.0504 (0.0489 to 0.0519)'
        >>> in_words(Estimate(0.05041, 0.04893, 0.05187, 100), percent=True)
        '5.04% (4.89% to 5.19%)'
        >>> in_words(Estimate(250.0, 250.0, 250.0, 10))
        '250 in all'
    """
    if not found.n:
        return "none"
    scale, unit = (100, "%") if percent else (1, "")
    width = scale * (found.high - found.low)
    if not width > 0:  # all the same, or just one
        return f"{_plain(scale * found.value)}{unit}{' in all' if width == 0 else ''}"
    decimals = max(0, 1 - math.floor(math.log10(width)))
    form = f"z,.{decimals}f" if decimals <= MOST_DECIMALS else ".2e"
    value, low, high = (f"{scale * of:{form}}{unit}" for of in (found.value, found.low, found.high))
    return f"{value} ({low} to {high})"


def _plain(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _share(n_happened: float, n: int) -> Estimate:
    """Return a share of `n`, with Clopper and Pearson's interval."""
    from scipy.special import betaincinv

    if not n:
        return Estimate(math.nan, math.nan, math.nan, 0)
    n_not, tail = n - n_happened, (1 - LEVEL) / 2
    low = float(betaincinv(n_happened, n_not + 1, tail)) if n_happened > 0 else 0.0
    high = 1 - float(betaincinv(n_not, n_happened + 1, tail)) if n_not > 0 else 1.0
    return Estimate(n_happened / n, low, high, n)


def _estimate(values: Values, size: Values, within: Range) -> Estimate:
    n = len(values)
    if n < 2:
        return Estimate(float(values[0]) if n else math.nan, math.nan, math.nan, n)
    value, low, high = _student(values, size, within)
    return Estimate(float(value), float(low), float(high), n)


def _student(values: Values, size: Values, within: Range) -> tuple[Values, Values, Values]:
    """Return means over the last axis, shape `(..., n)`, and the ends of their intervals.

    `size`, shape `(...)`, is what rounding errors are measured by.
    """
    from scipy.special import stdtrit

    n = values.shape[-1]
    same = np.ptp(values, axis=-1) <= SAME * size
    means = np.where(same, values[..., 0], values.mean(axis=-1))
    errors = np.where(same, 0.0, values.std(axis=-1, ddof=1) / math.sqrt(n))
    half = stdtrit(n - 1, (1 + LEVEL) / 2) * errors
    return means, np.maximum(means - half, within[0]), np.minimum(means + half, within[1])


def _size(values: Values) -> Values:
    """Return the largest absolute value over the last axis."""
    return np.asarray(np.abs(values).max(axis=-1, initial=0.0))
