"""The decisions that are kept in memory until a part of them is written."""

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from torch_iac.config import IACConfig
from torch_iac.experts.hybrid import HybridExperts
from torch_iac.memory_estimate import Recording
from torch_iac.records import Step
from torch_iac.runs.schema import USED_NETWORK, column_names, shadow_error, shadow_names
from torch_iac.space import SensorimotorSpace

DECISIONS_PER_PART = 2000
"""A part is written after so many decisions, or earlier where many agents are recorded."""

ROWS_PER_PART = 2**19
"""At most so many rows, a decision of an agent each, are kept in memory."""

READ_BYTES = 64
"""Bytes per recorded row while the summary is made, at the end."""

N_LOGGED_AGENTS = 64
"""Regions are logged for the first 64 agents."""

TOLD = ("errors", "expected_errors", "regions", "zones")
"""The fields of which TensorBoard is told."""

DTYPES = {
    "random_actions": torch.bool,
    "errors": torch.float64,
    "expected_errors": torch.float32,
    "regions": torch.int32,
    "progress": torch.float64,
    USED_NETWORK: torch.bool,
}
"""The fields of a step that are one number an agent; the rest are vectors in raw units, float32."""


def decisions_per_part(n_recorded: int, rows_per_part: int = ROWS_PER_PART) -> int:
    """Return how many decisions of so many recorded agents one part holds."""
    return max(1, min(DECISIONS_PER_PART, rows_per_part // n_recorded))


def row_bytes(space: SensorimotorSpace, shadows: Sequence[str], is_hybrid: bool = False) -> int:
    """Return how many bytes one decision of a recorded agent takes while it is kept in memory."""
    names = column_names(space, is_hybrid) | shadow_names(space, shadows)
    dtypes = _dtypes(shadows)
    return sum(len(n) * dtypes.get(field, torch.float32).itemsize for field, n in names.items())


def recording_bytes(
    space: SensorimotorSpace, config: IACConfig, n_decisions: int, n_recorded: int
) -> Recording:
    """Return how much memory the records of a run need.

    Args:
        space: What the agents do, sense and predict.
        config: The numbers of the algorithm.
        n_decisions: How many decisions each agent takes.
        n_recorded: Of how many every decision is recorded.
    """
    is_hybrid = isinstance(config.experts, HybridExperts)
    n_kept = min(n_decisions, decisions_per_part(n_recorded)) * n_recorded
    kept = n_kept * row_bytes(space, tuple(config.shadows), is_hybrid)
    # A part is written from a copy; in the end all that was recorded is read for the summary.
    return Recording(kept, on_host=max(2 * kept, n_decisions * n_recorded * READ_BYTES))


class Rows:
    """The decisions of recorded agents that are not yet on disk, in blocks made once.

    The blocks are on the device of the steps, so that no decision waits for a transfer.

    Attributes:
        count: How many they are.
        has_zones: Whether each comes with its zone.
        last_decision: The number of the last.
    """

    def __init__(
        self,
        capacity: int,
        space: SensorimotorSpace,
        seeds: Sequence[int],
        shadows: Sequence[str],
        has_zones: bool,
        is_hybrid: bool = False,
    ) -> None:
        self.count, self.has_zones, self.last_decision = 0, has_zones, -1
        self._n_before = 0  # decisions of the part before that were in the blocks
        self._seeds = np.array(seeds, np.int64)
        self._decisions = np.empty(capacity, np.int64)
        names = column_names(space, is_hybrid)
        self._fields_of = attrgetter(*names)
        zone = {"zones": ["zone"]} if has_zones else {}
        self._names = zone | names | shadow_names(space, shadows)
        dtypes, shape = _dtypes(shadows), (capacity, len(seeds))
        self._blocks = {
            field: torch.empty(shape, dtype=dtypes[field])
            if field in dtypes
            else torch.empty(*shape, len(names))
            for field, names in self._names.items()
        }
        self._device = torch.device("cpu")
        # On the host numpy copies small arrays in a third of the time.
        self._on_host = [block.numpy() for block in self._blocks.values()]

    @property
    def is_full(self) -> bool:
        """Whether it is time to write a part."""
        return self.count == len(self._decisions)

    def add(self, step: Step, zones: Tensor | None) -> None:
        """Copy one decision; `zones` have shape `(A,)`."""
        if self._device != step.errors.device:
            self._device = step.errors.device
            self._blocks = {field: b.to(self._device) for field, b in self._blocks.items()}
        self._decisions[self.count] = self.last_decision = step.number
        tensors: list[Tensor | None] = [] if zones is None else [zones]
        tensors += self._fields_of(step)
        for shadow in step.shadows:
            tensors += (shadow.predictions, shadow.errors)
        n_recorded, is_on_host = len(self._seeds), self._device.type == "cpu"
        blocks: Iterable[Any] = self._on_host if is_on_host else self._blocks.values()
        for tensor, block in zip(tensors, blocks, strict=True):
            if tensor is None:
                block[self.count] = torch.nan
            else:
                block[self.count] = (tensor.numpy() if is_on_host else tensor)[:n_recorded]
        self.count += 1

    def since(self, start: int) -> dict[str, NDArray[Any]]:
        """Return the fields of `TOLD`, each `(T, A)`, from a decision in memory on.

        Of the first agents only, as many as TensorBoard needs.
        """
        kept = slice(start, self.count)
        return {
            field: self._blocks[field][kept, :N_LOGGED_AGENTS].numpy(force=True)
            for field in TOLD
            if field in self._blocks
        }

    def last(self, n_decisions: int, field: str) -> NDArray[Any]:
        """Return a field of the last decisions of all, shape `(T, A)`, in any order.

        Those of the part before this one are there until they are overwritten; fewer come if that
        is so, or if there are no more.
        """
        new = slice(max(0, self.count - n_decisions), self.count)
        missing = n_decisions - (new.stop - new.start)
        old = slice(max(self.count, self._n_before - missing), max(self.count, self._n_before))
        block = self._blocks[field]
        return np.concatenate([block[of].numpy(force=True) for of in (old, new)])

    def clear(self) -> None:
        """Forget all."""
        self.count, self._n_before = 0, self.count

    def state(self) -> dict[str, Any]:
        """Return what is kept."""
        kept = slice(self.count)
        return {
            "last_decision": self.last_decision,
            "decisions": self._decisions[kept].copy(),
            "blocks": {field: block[kept].clone() for field, block in self._blocks.items()},
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` returned."""
        self.last_decision, self.count = state["last_decision"], len(state["decisions"])
        self._n_before = 0
        self._decisions[: self.count] = state["decisions"]
        for field, block in self._blocks.items():
            block[: self.count] = state["blocks"][field]

    def table(self) -> pa.Table:
        """Return what is kept, by step, then agent; valid until the next change."""
        n_agents, kept = len(self._seeds), slice(self.count)
        columns = {
            "step": np.repeat(self._decisions[kept], n_agents),
            "agent": np.tile(np.arange(n_agents, dtype=np.int32), self.count),
            "seed": np.tile(self._seeds, self.count),
        }
        for field, names in self._names.items():
            block = self._blocks[field][kept].numpy(force=True)
            by_name = block.reshape(self.count * n_agents, len(names)).T
            columns |= dict(zip(names, by_name, strict=True))
        return pa.table({name: pa.array(c, from_pandas=True) for name, c in columns.items()})


def _dtypes(shadows: Sequence[str]) -> dict[str, torch.dtype]:
    """Return the type of each field that is one number an agent."""
    return {"zones": torch.int8} | DTYPES | {shadow_error(s): torch.float64 for s in shadows}
