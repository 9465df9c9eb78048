"""Sums over windows of decisions: counts and sums of errors by agent and zone.

Of a large population, every agent has these sums at least. Shapes: `A` agents, `Z` zones, `F`
columns that are summed up. In a world without zones, one zone stands for all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True)
class WindowSums:
    """Counts of decisions, and sums of columns, by agent and zone.

    Attributes:
        counts: Shape `(..., A, Z)`, how many decisions.
        sums: Under the name of each column, its sums, of the same shape; NaN where there is nothing
            to sum up, such as expected errors without MP.
    """

    counts: NDArray[np.int64]
    sums: dict[str, NDArray[np.float64]]

    def __add__(self, other: "WindowSums") -> "WindowSums":
        """Return both together."""
        sums = {name: mine + other.sums[name] for name, mine in self.sums.items()}
        return WindowSums(self.counts + other.counts, sums)

    def __getitem__(self, windows: slice) -> "WindowSums":
        """Return some windows, which are the first axis."""
        return WindowSums(self.counts[windows], {name: s[windows] for name, s in self.sums.items()})

    def total(self, *axes: int) -> "WindowSums":
        """Return the sums over some axes, which keep a length of 1."""
        sums = {name: of.sum(axis=axes, keepdims=True) for name, of in self.sums.items()}
        return WindowSums(self.counts.sum(axis=axes, keepdims=True), sums)

    def means(self, column: str) -> NDArray[np.float64]:
        """Return the mean of a column, shape `(..., A, Z)`; NaN in a zone without decisions."""
        nothing = np.full(self.counts.shape, np.nan)
        means = np.divide(self.sums[column], self.counts, out=nothing, where=self.counts > 0)
        return np.asarray(means)


class RunningSums:
    """Sums that grow decision by decision, on the agents' device.

    Nothing is copied from there before `drain` is called.

    Args:
        n_agents: How many agents there are.
        n_zones: How many zones the world has; 0 if it has none.
        columns: What is summed up, in the order in which it will come.
    """

    def __init__(self, n_agents: int, n_zones: int, columns: Sequence[str]) -> None:
        self._columns, self._n_zones = columns, max(1, n_zones)
        self._first_cells = torch.arange(n_agents) * self._n_zones
        # The first row counts decisions.
        self._sums = torch.zeros(1 + len(columns), n_agents * self._n_zones, dtype=torch.float64)
        self._ones = torch.ones(n_agents, dtype=torch.float64)

    def add(self, zones: Tensor | None, values: Sequence[Tensor]) -> None:
        """Add one decision of every agent.

        Args:
            zones: Shape `(A,)`, where each was; None in a world without zones.
            values: What each column gets, shape `(A,)`, all on one device.

        Raises:
            ValueError: There is no such zone. On a GPU this is not checked, since the loop would
                wait.
        """
        if zones is not None and zones.device.type == "cpu":
            self._check(zones)
        if self._sums.device != values[0].device:
            self._move(values[0].device)
        cells = self._first_cells if zones is None else self._first_cells + zones
        added = torch.stack([self._ones, *(of.double() for of in values)])
        self._sums.index_add_(1, cells, added)

    def drain(self) -> WindowSums:
        """Return the sums since the last time, shape `(A, Z)`, and start from 0."""
        counts, *sums = self._sums.numpy(force=True).reshape(len(self._sums), -1, self._n_zones)
        taken = WindowSums(
            counts.astype(np.int64),
            {name: of.copy() for name, of in zip(self._columns, sums, strict=True)},
        )
        self._sums.zero_()
        return taken

    def state(self) -> Tensor:
        """Return the sums since the last time, shape `(1 + F, A * Z)`."""
        return self._sums.clone()

    def load_state(self, state: Tensor) -> None:
        """Go on from what `state` returned, shape `(1 + F, A * Z)`."""
        self._sums.copy_(state)

    def _check(self, zones: Tensor) -> None:
        least, most = (int(bound) for bound in zones.aminmax())
        if least < 0 or most >= self._n_zones:
            wrong = least if least < 0 else most
            raise ValueError(f"a zone must lie in [0, {self._n_zones - 1}], got {wrong}")

    def _move(self, device: torch.device) -> None:
        self._first_cells, self._sums, self._ones = (
            of.to(device) for of in (self._first_cells, self._sums, self._ones)
        )
