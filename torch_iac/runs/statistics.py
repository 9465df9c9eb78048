"""Statistics of a run over time, zones and deciles.

Shapes: `T` decisions, `A` agents, `Z` zones, `W` windows of decisions, `R` regions of an agent, `P`
points of a curve.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torch_iac.runs.reader import Run
from torch_iac.runs.schema import WINDOW
from torch_iac.runs.window_sums import WindowSums

CALIBRATED = 5000
"""How many first decisions MP's calibration leaves out; half of a run shorter than twice that. It
is taken over the agents whose steps are recorded."""

N_DECILES = 10
"""Into how many parts expectations are sorted."""


@dataclass(frozen=True)
class Expectation:
    """MP's expected errors of some decisions, and the actual ones.

    Attributes:
        expected: The mean expected error, in scaled units; NaN if there are no such decisions.
        actual: The mean error, in scaled units.
        n_decisions: How many decisions, of all agents together.
    """

    expected: float
    actual: float
    n_decisions: int

    @property
    def ratio(self) -> float:
        """How many times the actual error is expected; 1 if MP is calibrated."""
        return self.expected / self.actual if self.actual else np.nan


@dataclass(frozen=True)
class Calibration:
    """Whether the errors are those that MP expected; means over the recorded agents.

    Attributes:
        first_step: The decision from which on.
        overall: All decisions since.
        zones: Those in each zone of the world, if it has any.
        expected: Shape `(10,)`: the mean expectation of each tenth of an agent's decisions, from
            those with the lowest expectation to those with the highest, in scaled units.
        actual: Shape `(10,)`: their mean error, in scaled units.
    """

    first_step: int
    overall: Expectation
    zones: dict[str, Expectation]
    expected: NDArray[np.float64]
    actual: NDArray[np.float64]


def calibration(run: Run) -> Calibration:
    """Return how far the errors of a run are those that MP expected, once it has settled.

    Raises:
        ValueError: The run has no MP.
    """
    if not run.has_expectations:
        raise ValueError(f"the agents of {run.folder} have no MP, so they expect no errors")
    start = min(CALIBRATED, run.n_decisions // 2)
    expected, actual = (run.column(name)[start:] for name in ("expected_error", "error"))

    def within(here: NDArray[np.bool_]) -> Expectation:
        means = [known_mean(known_mean(of, axis=0, where=here)) for of in (expected, actual)]
        return Expectation(float(means[0]), float(means[1]), int(here.sum()))

    zones = run.column("zone")[start:] if run.zone_names else np.empty(0)
    return Calibration(
        start,
        within(np.ones_like(actual, np.bool_)),
        {name: within(zones == zone) for zone, name in enumerate(run.zone_names)},
        *by_decile(expected, actual),
    )


def zone_shares(run: Run, window: int = WINDOW) -> NDArray[np.float64]:
    """Return the share of its time that each agent spends in each zone, window after window.

    Args:
        run: The run.
        window: Decisions a window; a last window that is not full is left out. Any number if the
            steps of all agents are recorded, else a multiple of `WINDOW`.

    Returns:
        Shape `(W, A, Z)`.

    Raises:
        ValueError: The world has no zones, or no windows of that size were kept.

    Source: Oudeyer and Kaplan (2004), figure 3.
    """
    if not run.zone_names:
        raise ValueError(f"the world of {run.folder} has no zones, so it has no shares of them")
    return np.asarray(summed_up(run, "error", window).counts / window)


def zone_errors(run: Run, column: str = "error", window: int = WINDOW) -> NDArray[np.float64]:
    """Return the mean error of each agent in each zone, window after window.

    Args:
        run: The run.
        column: Whose errors, by their column; `run.error_columns` has them.
        window: Decisions a window, as `zone_shares` has it.

    Returns:
        Shape `(W, A, Z)`, in scaled units; NaN without decisions. In a world without zones there
        is one column.

    Raises:
        ValueError: The window is none that was kept.
    """
    return summed_up(run, column, window).means(column)


def summed_up(run: Run, column: str, window: int = WINDOW) -> WindowSums:
    """Return what every agent did in each full window of decisions, shape `(W, A, Z)`.

    Args:
        run: The run.
        column: What is summed up.
        window: Decisions a window, as `zone_shares` has it.

    Raises:
        ValueError: The window is none that was kept.
    """
    n_windows = run.n_decisions // window
    if window % WINDOW == 0 or window == run.n_decisions < WINDOW:
        n_kept = -(-window // WINDOW)  # kept windows per window asked for

        def joined(values: NDArray[Any]) -> NDArray[Any]:
            shape = (n_windows, n_kept, *values.shape[1:])
            return np.asarray(values[: n_windows * n_kept].reshape(shape).sum(axis=1))

        return WindowSums(
            joined(run.window_sums.counts), {column: joined(run.window_sums.sums[column])}
        )
    if run.n_recorded < run.n_agents:
        raise ValueError(
            f"window must be a multiple of {WINDOW} where the steps of {run.n_recorded} of "
            f"{run.n_agents} agents are recorded, got {window}"
        )
    values = run.column(column)
    zones = run.column("zone") if run.zone_names else np.zeros(values.shape, np.int8)
    shape = (n_windows, window, run.n_agents)
    values, zones = (of[: n_windows * window].reshape(shape) for of in (values, zones))
    here = [zones == zone for zone in range(max(1, len(run.zone_names)))]
    counts = np.stack([of.sum(axis=1) for of in here], axis=-1)
    sums = np.stack([np.sum(values, axis=1, where=of, dtype=np.float64) for of in here], axis=-1)
    return WindowSums(counts, {column: sums})


def by_decile(
    expected: NDArray[Any], actual: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return expected and actual errors by tenths of the expectation, from low to high.

    Args:
        expected: Shape `(T, A)`.
        actual: Shape `(T, A)`, the errors.

    Returns:
        The mean expectation of each tenth of each agent's decisions and their mean error, each of
        shape `(10,)`, means over agents; NaN for tenths of nothing.
    """
    order = np.argsort(expected, axis=0, kind="stable")

    def tenths(values: NDArray[Any]) -> NDArray[np.float64]:
        parts = np.array_split(np.take_along_axis(values, order, axis=0), N_DECILES)
        return np.array([known_mean(known_mean(part, axis=0)) for part in parts])

    return tenths(expected), tenths(actual)


def known_mean(
    values: NDArray[Any], axis: int | None = None, where: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the mean of values that are not NaN; NaN, without a warning, if there are none.

    Args:
        values: Any shape.
        axis: Along which the mean is taken, and which goes; along all if none is given.
        where: The shape of `values`, which of them count; all if not given.
    """
    counted = np.isfinite(values) if where is None else where & np.isfinite(values)
    n_counted = counted.sum(axis=axis)
    total = np.sum(values, axis=axis, where=counted, dtype=np.float64)
    nothing = np.full(np.shape(total), np.nan)
    return np.asarray(np.divide(total, n_counted, out=nothing, where=n_counted > 0))


def focus_steps(run: Run, zone: str, share: float, window: int = WINDOW) -> list[int | None]:
    """Return when each agent first focuses on a zone: spends more than `share` of a window in it.

    Returns:
        The first decision of that window, agent by agent; None for an agent that never does.

    Raises:
        ValueError: The world has no such zone, or no windows of that size were kept.
    """
    focused = zone_shares(run, window)[:, :, run.zone_names.index(zone)] > share
    return [int(mine.argmax()) * window if mine.any() else None for mine in focused.T]
