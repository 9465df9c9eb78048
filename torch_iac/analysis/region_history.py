"""Regions of a run over time: errors, bounds, zones and ancestors.

Shapes: `T` decisions, `A` agents, `Z` zones, `W` windows of decisions, `R` regions of an agent, `P`
points of a curve.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from torch_iac.runs.reader import Run


def leaf_purity(run: Run, zones: NDArray[np.integer[Any]] | None = None) -> NDArray[np.float64]:
    """Return which share of each agent's decisions lies in a leaf that is mostly of their zone.

    Leaves are those that there are when the run ends. With one leaf it is the share of the zone
    that the agent was in most.

    Args:
        run: A run in a world with zones.
        zones: The zone of each decision, shape `(T, A)`, as recorded by default; shuffled ones
            show the purity of as many leaves by chance.

    Returns:
        Shape `(A,)`, of the recorded agents.

    Source: the claim is that of Oudeyer and Kaplan (2004), section 2.2, that groups of experts are
    self-coherent; how it is measured is this library's.
    """
    zones = run.column("zone") if zones is None else zones
    leaves, n_zones = final_leaves(run), len(run.zone_names)
    purity = np.empty(run.n_recorded)
    for agent in range(run.n_recorded):
        counts = np.bincount(leaves[:, agent] * n_zones + zones[:, agent], minlength=n_zones)
        padded = np.pad(counts, (0, -len(counts) % n_zones))
        purity[agent] = padded.reshape(-1, n_zones).max(axis=1).sum() / len(leaves)
    return purity


@dataclass(frozen=True)
class ErrorCurve:
    """The mean error of a region from its birth to its split or the end of the run.

    Attributes:
        region: Which region.
        decisions: Shape `(P,)`: when; the birth, each decision it predicted, the end.
        mean_errors: Shape `(P,)`: the mean of its last errors then, in scaled units.
        n_errors: Shape `(P,)`: how many errors the mean is over.
    """

    region: int
    decisions: NDArray[np.int64]
    mean_errors: NDArray[np.float64]
    n_errors: NDArray[np.int64]

    def of_at_least(self, n_errors: int) -> Self:
        """Return the part whose means are over so many errors."""
        kept = self.n_errors >= n_errors
        return replace(
            self,
            decisions=self.decisions[kept],
            mean_errors=self.mean_errors[kept],
            n_errors=self.n_errors[kept],
        )


def error_curves(run: Run, agent: int = 0, window: int | None = None) -> list[ErrorCurve]:
    """Return the mean error over time of every region that has one, in order of birth.

    A child inherits its parent's errors, so its curve starts where its parent's ends; in a run
    whose config says that nothing is inherited, it starts with the child's own first error.

    Args:
        run: The run.
        agent: Whose regions.
        window: How many of the region's last errors the mean is over, fewer while it has fewer;
            the run's own `error_window` if none is given.

    Raises:
        ValueError: There is no such agent, or its steps are not recorded.

    Source: Oudeyer and Kaplan (2004), figure 2.
    """
    window = run.error_window if window is None else window
    steps = run.table(["error", "region"], agent)
    errors = steps["error"].to_numpy()
    own_decisions = decisions_by_region(steps["region"].to_numpy())
    nothing = np.empty(0, dtype=np.int64)
    no_errors = np.empty(0)
    last_errors: dict[int, NDArray[np.float64]] = {-1: no_errors}
    curves = []
    for row in run.family(agent).to_pylist():
        region, inherited = row["region"], last_errors[row["parent"]]
        own = own_decisions.get(region, nothing)
        history = np.concatenate([inherited, errors[own]])
        last_errors[region] = history[-window:] if run.inherits_history else no_errors
        if not len(history):
            continue
        first = max(len(inherited) - 1, 0)
        means = _running_mean(history, window)[first:]
        n_errors = np.minimum(np.arange(first + 1, len(history) + 1), window)
        birth = [row["born_step"]] if len(inherited) else []
        end = len(errors) - 1 if row["split_step"] < 0 else row["split_step"]
        curves.append(
            ErrorCurve(
                region,
                np.array([*birth, *own.tolist(), end], dtype=np.int64),
                np.append(means, means[-1]),
                np.append(n_errors, n_errors[-1]),
            )
        )
    return curves


def ancestors(run: Run, region: int, agent: int = 0) -> tuple[int, ...]:
    """Return a region's parent, its parent's parent and so on to the root.

    Raises:
        ValueError: There is no such agent.
        IndexError: It has no such region.
    """
    parents = run.family(agent)["parent"].to_numpy()
    line = []
    while (region := int(parents[region])) >= 0:
        line.append(region)
    return tuple(line)


def children_of(family: Sequence[Mapping[str, Any]]) -> dict[int, list[int]]:
    """Return the children of each region of an agent: the one below its cut, the one above.

    Args:
        family: The rows of `Run.family`; the root is the only child of -1.
    """
    children: dict[int, list[int]] = {}
    for row in family:  # the child below the cut comes first
        children.setdefault(row["parent"], []).append(row["region"])
    return children


def region_bounds(run: Run, region: int, agent: int = 0) -> dict[str, tuple[float, float]]:
    """Return where a region lies: its bounds, in raw units, in each dimension that was cut for it.

    Dimensions are in the order of the first cut along each, from the root on.

    Raises:
        ValueError: There is no such agent.
        IndexError: It has no such region.
    """
    family = run.family(agent).to_pylist()
    children = children_of(family)
    whole = {dimension.name: (dimension.low, dimension.high) for dimension in run.space.situation}
    bounds: dict[str, tuple[float, float]] = {}
    line = [region, *ancestors(run, region, agent)]
    for parent, child in reversed(list(zip(line[1:], line, strict=False))):
        name, value = family[parent]["cut_dimension"], family[parent]["cut_value"]
        low, high = bounds.get(name, whole[name])
        bounds[name] = (low, value) if child == children[parent][0] else (value, high)
    return bounds


@dataclass(frozen=True)
class RegionZones:
    """Which zone of the world each region of an agent covers, by the decisions it predicted.

    Attributes:
        zone: Shape `(R,)`: the zone most of them were in; -1 for a region without any.
        purity: Shape `(R,)`: their share in that zone; NaN for a region without any.
    """

    zone: NDArray[np.int64]
    purity: NDArray[np.float64]


def region_zones(run: Run, agent: int = 0) -> RegionZones:
    """Return the zone that each region of an agent mostly covers, in a world with zones.

    Raises:
        ValueError: There is no such agent, its steps are not recorded, or there are no zones.
    """
    steps = run.table(["region", "zone"], agent)
    counts = np.zeros((run.family(agent).num_rows, len(run.zone_names)))
    np.add.at(counts, (steps["region"].to_numpy(), steps["zone"].to_numpy()), 1)
    total = counts.sum(axis=1)
    share = np.divide(counts.max(axis=1), total, out=np.full(len(total), np.nan), where=total > 0)
    return RegionZones(np.where(total > 0, counts.argmax(axis=1), -1), share)


def decisions_by_region(regions: NDArray[np.int32]) -> dict[int, NDArray[np.int64]]:
    """Return, for each region that ever predicted, the decisions in which it did.

    Args:
        regions: Shape `(T,)`: the region that predicted at each decision.
    """
    order = np.argsort(regions, kind="stable")
    names, starts = np.unique(regions[order], return_index=True)
    return dict(zip(names.tolist(), np.split(order, starts[1:]), strict=True))


def final_leaves(run: Run) -> NDArray[np.int64]:
    """Return the leaf in which each situation lies when the run ends, shape `(T, A)`.

    That is the recorded `region`, or one that came of it by later splits; of recorded agents.
    """
    situations = {
        name: run.column(column)
        for name, column in zip(run.space.situation_names, run.situation_columns, strict=True)
    }
    leaves = np.zeros((run.n_decisions, run.n_recorded), np.int64)
    for agent in range(run.n_recorded):
        mine = {name: values[:, agent] for name, values in situations.items()}
        _route(leaves[:, agent], run.family(agent).to_pylist(), mine)
    return leaves


def _route(
    regions: NDArray[np.int64],
    family: Sequence[Mapping[str, Any]],
    situations: Mapping[str, NDArray[np.float32]],
) -> None:
    """Move situations from the root to their leaves, in place; parents come before children."""
    children = children_of(family)
    for row in family:
        if row["split_step"] >= 0:
            here = np.flatnonzero(regions == row["region"])
            above = situations[row["cut_dimension"]][here] > row["cut_value"]
            left, right = children[row["region"]]
            regions[here] = np.where(above, right, left)


def _running_mean(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Return the mean of the last `window` values at each place, of fewer near the start."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - window, 0)
    return np.asarray((total[end] - total[start]) / (end - start))
