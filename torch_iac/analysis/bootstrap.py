"""Means, differences and probabilities of improvement, with bootstrap intervals.

Intervals are of 95 %, by the percentile bootstrap over robots; the same values give the same
interval. With few robots they are too narrow: those of five robots cover the true
value in about 84 of 100 cases.

Source: Agarwal, Schwarzer, Castro, Courville and Bellemare (2021), "Deep Reinforcement Learning at
the Edge of the Statistical Precipice".
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

N_RESAMPLES = 5000
"""Number of bootstrap resamples."""

BATCH = 2_000_000
"""Values per batch of resamples, which bounds memory."""

Values = NDArray[np.float64]
"""One number for each robot along the last axis, in any units."""


@dataclass(frozen=True)
class Estimate:
    """A number and its interval.

    Attributes:
        value: The number; NaN without robots.
        low: The lower end of its interval; NaN with less than two robots.
        high: The upper end.
        n: Number of robots, or of pairs of robots.
    """

    value: float
    low: float
    high: float
    n: int


def mean(values: Values) -> Estimate:
    """Return the mean of values, shape `(n,)`."""
    return _estimate(_mean, values)


def difference(one: Values, other: Values) -> Estimate:
    """Return how much larger the mean of the one is, robots being paired; both of shape `(n,)`."""
    return _estimate(_difference, one, other)


def probability_larger(one: Values, other: Values) -> Estimate:
    """Return how probably a robot of the one has a larger value than any robot of the other.

    Equal values count half. The bootstrap draws pairs, since robots are paired; both of shape
    `(n,)`.

    Example:
        >>> probability_larger(np.array([2.0, 3.0, 5.0]), np.array([1.0, 2.0, 4.0])).value
        0.7222222222222222
    """
    return _estimate(_share_larger, one, other)


def band(values: Values) -> tuple[Values, Values]:
    """Return the ends of the intervals of means over the last axis, shape `(..., n)`."""
    if values.shape[-1] < 2:
        nothing = np.full(values.shape[:-1], np.nan)
        return nothing, nothing
    return _interval(_mean, values)


def _estimate(statistic: Callable[..., Any], *samples: Values) -> Estimate:
    n = len(samples[0])
    if not n:
        return Estimate(np.nan, np.nan, np.nan, 0)
    value = float(statistic(*samples))
    low, high = _interval(statistic, *samples) if n > 1 else (np.nan, np.nan)
    return Estimate(value, float(low), float(high), n)


def _interval(statistic: Callable[..., Any], *samples: Values) -> tuple[Values, Values]:
    from scipy.stats import bootstrap  # it takes a second to import

    found = bootstrap(
        samples,
        statistic,
        n_resamples=N_RESAMPLES,
        batch=max(1, BATCH // samples[0].size),
        vectorized=True,
        paired=True,
        axis=-1,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = found.confidence_interval
    return low, high


def _mean(values: Values, axis: int = -1) -> Any:
    return values.mean(axis=axis)


def _difference(one: Values, other: Values, axis: int = -1) -> Any:
    return one.mean(axis=axis) - other.mean(axis=axis)


def _share_larger(one: Values, other: Values, axis: int = -1) -> Any:
    """Return in which share of all pairs the one is larger, by Mann and Whitney's U."""
    from scipy.stats import rankdata

    n, m = one.shape[axis], other.shape[axis]
    ranks = rankdata(np.concatenate([one, other], axis=axis), axis=axis)
    of_one = np.take(ranks, np.arange(n), axis=axis).sum(axis=axis)
    return (of_one - n * (n + 1) / 2) / (n * m)
