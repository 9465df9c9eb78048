"""How an agent's sensorimotor space was divided into regions, at any time of its run.

Shapes: `L` leaves, `D` situation dimensions.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from torch_iac.analysis.region_history import children_of, decisions_by_region
from torch_iac.runs.reader import Run
from torch_iac.space import Dimension, SensorimotorSpace

Values = NDArray[np.float64]
"""A number a leaf, shape `(L,)`, or a number a leaf and dimension, `(L, D)`."""


@dataclass(frozen=True)
class Partition:
    """Leaves, each a box in the sensorimotor space, in raw units; all together fill it.

    A box holds what lies above its low sides and at most at its high ones.

    Attributes:
        space: What has been divided.
        regions: Shape `(L,)`: the number of each leaf.
        progress: Shape `(L,)`: its learning progress, in scaled units.
        lows: Shape `(L, D)`.
        highs: Shape `(L, D)`.
    """

    space: SensorimotorSpace
    regions: NDArray[np.int64]
    progress: Values
    lows: Values
    highs: Values

    def sides(self, name: str) -> tuple[Values, Values]:
        """Return the low and the high side of each box along a dimension, each of shape `(L,)`.

        Raises:
            ValueError: There is no such dimension.
        """
        column, _ = self._dimension(name)
        return self.lows[:, column], self.highs[:, column]

    def through(self, point: Mapping[str, float]) -> Self:
        """Return the leaves that hold some coordinates, whatever the others are.

        Args:
            point: Coordinates by the names of their dimensions, in raw units. If two dimensions are
                left out, the leaves are rectangles that fill the plane of these two.

        Raises:
            ValueError: There is no such dimension, or a coordinate is outside its bounds.
        """
        holds = np.full(len(self.regions), True)
        for name, value in point.items():
            _, dimension = self._dimension(name)
            if not dimension.low <= value <= dimension.high:
                bounds = f"[{dimension.low:g}, {dimension.high:g}]"
                raise ValueError(f"{name} must lie in {bounds}, got {value:g}")
            lows, highs = self.sides(name)
            # The lowest value of all belongs to the lowest box.
            holds &= ((lows < value) | (lows <= dimension.low)) & (value <= highs)
        return replace(
            self,
            regions=self.regions[holds],
            progress=self.progress[holds],
            lows=self.lows[holds],
            highs=self.highs[holds],
        )

    def _dimension(self, name: str) -> tuple[int, Dimension]:
        names = self.space.situation_names
        if name not in names:
            raise ValueError(f"a dimension must be one of {', '.join(names)}, got {name}")
        column = names.index(name)
        return column, self.space.situation[column]


def partition_of(run: Run, step: int | None = None, agent: int = 0) -> Partition:
    """Return an agent's regions when it chose a decision, and their progress then.

    Args:
        run: The run.
        step: Which decision; after the last one if none is given.
        agent: Whose space.

    Raises:
        ValueError: There is no such decision or agent, or its steps are not recorded.
    """
    (partition,) = partitions_of(run, [run.n_decisions if step is None else step], agent)
    return partition


def partitions_of(run: Run, steps: Iterable[int], agent: int = 0) -> Iterator[Partition]:
    """Yield an agent's regions when it chose some decisions; files are read once.

    Args:
        run: The run.
        steps: Which decisions; their number is the end of the run.
        agent: Whose space.

    Raises:
        ValueError: There is no such decision or agent, or its steps are not recorded.
    """
    family = run.family(agent).to_pylist()
    lows, highs = _boxes(family, run.space)
    columns = run.table(["error", "region"], agent)
    errors = columns["error"].to_numpy()
    own_decisions = decisions_by_region(columns["region"].to_numpy())
    for step in steps:
        if not 0 <= step <= len(errors):
            raise ValueError(f"step must lie in [0, {len(errors)}], got {step}")
        leaves = [row["region"] for row in family if _is_leaf(row, step)]
        histories = (_history(run, family, own_decisions, leaf, step) for leaf in leaves)
        progress = np.array([_progress(run, errors[of]) for of in histories])
        yield Partition(run.space, np.array(leaves), progress, lows[leaves], highs[leaves])


def situation_at(run: Run, step: int, agent: int = 0) -> dict[str, float]:
    """Return the situation of a decision, action and sensors, by their names.

    In raw units; what a sensor reads outside its bounds the robot takes for the bound.

    Raises:
        ValueError: There is no such decision or agent, or its steps are not recorded.
    """
    if not 0 <= step < run.n_decisions:
        raise ValueError(f"step must lie in [0, {run.n_decisions}), got {step}")
    columns = run.situation_columns
    row = run.table(columns, agent).slice(step, 1).to_pylist()[0]
    return {
        dimension.name: min(max(row[column], dimension.low), dimension.high)
        for dimension, column in zip(run.space.situation, columns, strict=True)
    }


def _is_leaf(row: Mapping[str, Any], step: int) -> bool:
    """Return whether a region existed, and was not split yet, when a decision was chosen."""
    is_born = row["parent"] < 0 or row["born_step"] < step
    return bool(is_born and (row["split_step"] < 0 or row["split_step"] >= step))


def _boxes(family: Sequence[Mapping[str, Any]], space: SensorimotorSpace) -> tuple[Values, Values]:
    """Return the low and high sides of every region, `(R, D)`; parents come before children."""
    lows = np.tile([d.low for d in space.situation], (len(family), 1)).astype(np.float64)
    highs = np.tile([d.high for d in space.situation], (len(family), 1)).astype(np.float64)
    children = children_of(family)
    for row in family:
        region, parent = row["region"], row["parent"]
        if parent < 0:
            continue
        lows[region], highs[region] = lows[parent], highs[parent]
        column = space.situation_names.index(family[parent]["cut_dimension"])
        side = highs if region == children[parent][0] else lows
        side[region, column] = family[parent]["cut_value"]
    return lows, highs


def _history(
    run: Run,
    family: Sequence[Mapping[str, Any]],
    own_decisions: Mapping[int, NDArray[np.int64]],
    region: int,
    step: int,
) -> NDArray[np.int64]:
    """Return the decisions before a step whose errors make the progress of a region."""
    history, n_needed = np.empty(0, np.int64), run.error_window + run.delay
    while region >= 0 and len(history) < n_needed:
        own = own_decisions.get(region, np.empty(0, np.int64))
        # Ancestors predicted before their children were born.
        history = np.concatenate([own[: np.searchsorted(own, step)], history])
        region = family[region]["parent"] if run.inherits_history else -1
    return history


def _progress(run: Run, errors: NDArray[np.float64]) -> float:
    """Return the learning progress that errors, the last ones last, make by its definition."""
    window, delay = run.error_window, run.delay
    if len(errors) < window + delay:
        return 0.0
    before = errors[: len(errors) - delay][-window:]
    return float(before.mean() - errors[-window:].mean())
