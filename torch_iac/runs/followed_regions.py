"""Which regions of the first robot have curves in TensorBoard, where they lie, and their names.

Shapes: `T` decisions, `R` regions ever made, `L` present leaves, `Z` zones; in a world without
zones, one zone stands for all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from torch_iac.records import Genealogy
from torch_iac.regions.tree import NONE
from torch_iac.space import SensorimotorSpace

LEAST_PURITY = 2 / 3
"""A region lies in a zone if so large a share of its decisions was in it."""

N_FOLLOWED = 10
"""So many regions have curves at a time."""


@dataclass(frozen=True)
class Family:
    """The regions of the first robot, in order of birth.

    Attributes:
        parents: The parent of each; `NONE` for the root.
        leaves: Shape `(L,)`: those that are not cut.
        cut_dimensions: Shape `(R,)`, of the situation; `NONE` for a leaf.
        cut_values: Shape `(R,)`, in the unit cube; NaN for a leaf.
    """

    parents: list[int]
    leaves: NDArray[np.int64]
    cut_dimensions: NDArray[np.int64]
    cut_values: NDArray[np.float64]

    @classmethod
    def of(cls, genealogy: Genealogy) -> Self:
        """Return the first robot's part of all regions."""
        own = genealogy.agent.numpy() == 0
        return cls(
            genealogy.parent.numpy()[own].tolist(),
            np.flatnonzero(genealogy.split_step.numpy()[own] == NONE),
            genealogy.cut_dimension.numpy()[own],
            genealogy.cut_value.double().numpy()[own],
        )

    def cut_of(self, region: int, space: SensorimotorSpace) -> str:
        """Return in words how a region was cut off its parent, in raw units; not for the root."""
        parent = self.parents[region]
        dimension = space.situation[self.cut_dimensions[parent]]
        value = dimension.low + self.cut_values[parent] * (dimension.high - dimension.low)
        is_below = self.parents.index(parent) == region  # the child below the cut comes first
        return f"{dimension.name} {'<=' if is_below else '>'} {value:.3g}"


class Visits:
    """How many decisions the first robot took in each region, by zone.

    Args:
        n_zones: How many zones the world has; 0 if it has none.
    """

    def __init__(self, n_zones: int) -> None:
        self._n_zones = n_zones
        self._counts = np.zeros((0, max(1, n_zones)), np.int64)

    def add(self, regions: NDArray[np.int32], zones: NDArray[np.int8] | None) -> None:
        """Count decisions, by the regions and the zones that they were in, shape `(T,)` each."""
        if not len(regions):
            return
        n_new = int(regions.max()) + 1 - len(self._counts)
        if n_new > 0:
            # Room for more than is needed, so that growing costs little in all.
            self._counts = np.pad(self._counts, ((0, n_new + len(self._counts)), (0, 0)))
        cells = regions * self._counts.shape[1] + (0 if zones is None else zones)
        np.add.at(self._counts.reshape(-1), cells, 1)

    def totals(self, n_regions: int) -> NDArray[np.int64]:
        """Return the decisions in each of the first regions, shape `(n_regions,)`."""
        totals = np.zeros(n_regions, np.int64)
        known = self._counts[:n_regions].sum(axis=1)
        totals[: len(known)] = known
        return totals

    def zones(self, n_regions: int) -> NDArray[np.int64]:
        """Return the zone in which each of the first regions lies, shape `(n_regions,)`.

        `NONE` for a region without decisions, or of several zones.
        """
        zones = np.full(n_regions, NONE)
        if self._n_zones:
            counts = self._counts[:n_regions]
            lies = counts.max(axis=1) >= np.maximum(1, LEAST_PURITY * counts.sum(axis=1))
            zones[: len(counts)] = np.where(lies, counts.argmax(axis=1), NONE)
        return zones

    def state(self) -> NDArray[np.int64]:
        """Return all counts, shape `(R, Z)`."""
        return self._counts.copy()

    def load_state(self, state: NDArray[np.int64]) -> None:
        """Go on from what `state` returned, shape `(R, Z)`."""
        self._counts = state.copy()


class Followed:
    """The regions that have curves now: those in which the robot is.

    A region keeps its curve until it is cut or the robot has left it, which shows at the next
    choice; then a region without a curve gets one, that of the most decisions since the last
    choice.

    Args:
        space: What the robots do, sense and predict.
        zone_names: The names of the world's zones; none if it has no zones.

    Attributes:
        names: Every region that has or had a curve, with its name in tags.
        present: Those that have one now.
    """

    def __init__(self, space: SensorimotorSpace, zone_names: Sequence[str]) -> None:
        self._space, self._zone_names = space, zone_names
        self.names: dict[int, str] = {}
        self.present: list[int] = []
        self._counted = np.zeros(0, np.int64)  # the visits at the last choice

    def choose(self, family: Family, visits: Visits) -> list[int]:
        """Choose anew; return the regions that have a name for the first time.

        Args:
            family: The regions that there are.
            visits: The robot's decisions in each of them.
        """
        n_regions = len(family.parents)
        totals = visits.totals(n_regions)
        recent = totals.copy()
        recent[: len(self._counted)] -= self._counted
        self._counted = totals
        here = family.leaves[recent[family.leaves] > 0]
        by_visits = here[np.argsort(-recent[here], kind="stable")].tolist()
        kept = [region for region in self.present if region in by_visits]
        others = [region for region in by_visits if region not in kept]
        self.present = kept + others[: N_FOLLOWED - len(kept)]
        new = [region for region in self.present if region not in self.names]
        zones = visits.zones(n_regions)
        self.names |= {region: self._name(region, family, int(zones[region])) for region in new}
        return new

    def _name(self, region: int, family: Family, zone: int) -> str:
        """Return a region's name: its number, its zone if it lies in one, its cut, its parent."""
        place = f" {self._zone_names[zone]}" if zone != NONE else ""
        parent = family.parents[region]
        if parent == NONE:
            return f"region {region}{place}"
        return f"region {region}{place}: {family.cut_of(region, self._space)}, of {parent}"

    def state(self) -> dict[str, Any]:
        """Return the names, the present regions and the visits at the last choice."""
        return {
            "regions": list(self.names),
            "names": list(self.names.values()),
            "present": list(self.present),
            "counted": self._counted.copy(),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` returned."""
        self.names = dict(zip(state["regions"], state["names"], strict=True))
        self.present, self._counted = list(state["present"]), state["counted"].copy()
