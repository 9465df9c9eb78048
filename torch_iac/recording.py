"""Writes a run folder: its decisions, its regions, TensorBoard, a summary.

Every file is written under a temporary name, fsynced and renamed, so whatever has its final name is
whole, also after a crash. Shapes: `A` agents, `T` decisions in one part, `S` regions.
"""

import time
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from torch import Tensor

from torch_iac.agent import RegionSummary, Step
from torch_iac.dashboard import Dashboard
from torch_iac.files import dump_json, replace
from torch_iac.measures import summarise
from torch_iac.regions import NONE, Genealogy
from torch_iac.runs import CONFIG, MAIN, REGIONS, STEPS, SUMMARY, load_run, part_path, shadow_error
from torch_iac.space import Dimension, SensorimotorSpace

DECISIONS_PER_PART = 2000
"""A part is written after so many decisions, or earlier in a large population."""

DTYPES = {
    "random_actions": np.bool_,
    "errors": np.float64,
    "expected_errors": np.float32,
    "regions": np.int32,
    "progress": np.float64,
}
"""The fields of a step that are one number an agent; the rest are vectors in raw units, float32."""

RESERVED = (MAIN, "mean", "expected")
"""What no shadow can be called: errors of these names are others'."""


class Recorded(Protocol):
    """What a recorder asks of the agent that it records; `IAC` has it."""

    @property
    def space(self) -> SensorimotorSpace:
        """What the agents do, sense and predict."""

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each agent."""

    @property
    def shadows(self) -> Mapping[str, Any]:
        """The experts that only look on, by name."""

    def genealogy(self) -> Genealogy:
        """Return every region ever made."""

    def region_summary(self) -> RegionSummary:
        """Return what each present leaf knows."""


class Recorder:
    """Writes a run folder, decision by decision; a context manager.

    ```python
    with Recorder(Path("runs/a"), agent, config={"preset": "iac2004"}) as recorder:
        for _ in range(10_000):
            ...
            recorder.record(agent.observe(sensors))
    ```

    Leaving the block without an error writes `summary.json`: a folder that has one holds a run that
    went to its end. Leaving it with an error writes the decisions taken until then.

    TensorBoard shows aggregates over all agents and, region by region, agent 0.

    Args:
        folder: Where to write; made if it is not there.
        agent: The population that is recorded.
        zone_names: The names of the world's zones, if it has any.
        config: What else `config.json` shall hold, besides the space, the seeds, the zones and the
            names of the shadows.
        log_every: How many decisions lie between two logs to TensorBoard.
        rows_per_part: At most so many rows (a decision of an agent) are kept in memory.

    Raises:
        FileExistsError: The folder already holds a run; it is not touched.
        NotADirectoryError: The folder is a file, or would lie in one.
        ValueError: `log_every` or `rows_per_part` is below 1, or a shadow has a name of `RESERVED`.
    """

    def __init__(
        self,
        folder: Path,
        agent: Recorded,
        zone_names: Sequence[str] | None = None,
        config: Mapping[str, Any] | None = None,
        *,
        log_every: int = 100,
        rows_per_part: int = 2**18,
    ) -> None:
        for name, value in (("log_every", log_every), ("rows_per_part", rows_per_part)):
            if value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}")
        shadows = tuple(agent.shadows)
        for name in shadows:
            if name in RESERVED:
                raise ValueError(f"shadows must not be called {', '.join(RESERVED)}, got {name}")
        self.folder = Path(folder)
        _claim(self.folder)
        known = {
            "space": agent.space.to_json(),
            "seeds": agent.seeds,
            "zones": zone_names,
            "shadows": shadows,
        }
        write_config(self.folder, {**(config or {}), **known})
        n_decisions = max(1, min(DECISIONS_PER_PART, rows_per_part // len(agent.seeds)))
        self._agent, self._log_every = agent, log_every
        self._rows = _Rows(n_decisions, agent.space, agent.seeds, shadows, zone_names is not None)
        self._n_parts = self._n_tallied = 0
        self._dashboard = Dashboard(self.folder, len(agent.seeds), zone_names or (), shadows)
        self._started = time.perf_counter()

    def record(self, step: Step, zones: NDArray[Any] | Tensor | None = None) -> None:
        """Keep one decision of every agent.

        Args:
            step: What `observe` returned.
            zones: Shape `(A,)`, the zone of the world that each was in; None without zones.

        Raises:
            ValueError: Zones are missing, or there are zones and the world has none.
        """
        if (zones is not None) != self._rows.has_zones:
            raise ValueError("record needs zones if, and only if, the recorder has zone_names")
        self._rows.add(step, zones)
        if (step.number + 1) % self._log_every == 0:
            self._tally()
            self._dashboard.log(
                step.number + 1, self._agent.region_summary(), self._agent.genealogy
            )
        if self._rows.is_full:
            self.flush()

    def flush(self) -> None:
        """Write what is kept in memory; when it returns, all decisions so far are on disk."""
        if not self._rows.count:
            return
        self._tally()
        regions = region_table(self._agent.genealogy(), self._agent.space)
        _write_table(self.folder / REGIONS, regions)
        _write_table(part_path(self.folder, self._n_parts), self._rows.table())
        self._rows.clear()
        self._n_parts, self._n_tallied = self._n_parts + 1, 0
        self._dashboard.flush()

    def close(self) -> None:
        """Write the rest and `summary.json`; nothing can be recorded any more."""
        seconds = time.perf_counter() - self._started
        self.flush()
        self._dashboard.close()
        if self._n_parts:
            measures = summarise(load_run(self.folder), seconds)
            _write_json(self.folder / SUMMARY, measures)

    def _tally(self) -> None:
        """Show the dashboard what was recorded since the last time."""
        self._dashboard.tally(self._rows.since(self._n_tallied))
        self._n_tallied = self._rows.count

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.flush()
            self._dashboard.close()


def write_config(folder: Path, config: Mapping[str, Any]) -> None:
    """Write `config.json`."""
    _write_json(folder / CONFIG, config)


def region_table(genealogy: Genealogy, space: SensorimotorSpace) -> pa.Table:
    """Return the rows of `regions.parquet`: cuts by name and in raw units, null for leaves."""
    cut = genealogy.cut_dimension.numpy()
    is_leaf = cut == NONE
    low = np.array([dimension.low for dimension in space.situation])[cut]
    high = np.array([dimension.high for dimension in space.situation])[cut]
    value = low + genealogy.cut_value.double().numpy() * (high - low)
    name = np.array(space.situation_names, dtype=object)[cut]
    return pa.table(
        {
            "agent": pa.array(genealogy.agent.numpy(), pa.int32()),
            "region": pa.array(genealogy.region.numpy(), pa.int32()),
            "parent": pa.array(genealogy.parent.numpy(), pa.int32()),
            "depth": pa.array(genealogy.depth.numpy(), pa.int32()),
            "born_step": pa.array(genealogy.born_step.numpy(), pa.int64()),
            "split_step": pa.array(genealogy.split_step.numpy(), pa.int64()),
            "cut_dimension": pa.array(name, pa.string(), mask=is_leaf),
            "cut_value": pa.array(value, pa.float64(), mask=is_leaf),
            "n_examples": pa.array(genealogy.n_examples.numpy(), pa.int32()),
        }
    )


class _Rows:
    """The decisions that are not yet on disk, in arrays made once.

    Attributes:
        count: How many they are.
        has_zones: Whether each comes with its zone.
    """

    def __init__(
        self,
        capacity: int,
        space: SensorimotorSpace,
        seeds: Sequence[int],
        shadows: Sequence[str],
        has_zones: bool,
    ) -> None:
        self.count, self.has_zones = 0, has_zones
        self._seeds = np.array(seeds, np.int64)
        self._decisions = np.empty(capacity, np.int64)
        self._zones = np.empty((capacity, len(seeds)), np.int8)
        names = _column_names(space)
        self._fields_of = attrgetter(*names)
        self._names = names | _shadow_names(space, shadows)
        dtypes = DTYPES | {shadow_error(name): np.float64 for name in shadows}
        shape = (capacity, len(seeds))
        self._values: dict[str, NDArray[Any]] = {
            field: np.empty(shape, dtypes[field])
            if field in dtypes
            else np.empty((*shape, len(names)), np.float32)
            for field, names in self._names.items()
        }

    @property
    def is_full(self) -> bool:
        return self.count == len(self._decisions)

    def add(self, step: Step, zones: NDArray[Any] | Tensor | None) -> None:
        """Copy one decision."""
        self._decisions[self.count] = step.number
        if zones is not None:
            on_host = zones.numpy(force=True) if isinstance(zones, Tensor) else zones
            self._zones[self.count] = on_host
        tensors = self._fields_of(step)
        for shadow in step.shadows:
            tensors += (shadow.predictions, shadow.errors)
        for tensor, values in zip(tensors, self._values.values(), strict=True):
            values[self.count] = np.nan if tensor is None else tensor.numpy(force=True)
        self.count += 1

    def since(self, start: int) -> dict[str, NDArray[Any]]:
        """Return the fields of the decisions kept at `start` and later, each `(T, A, ...)`."""
        columns = {"zones": self._zones} if self.has_zones else {}
        return {name: kept[start : self.count] for name, kept in (columns | self._values).items()}

    def clear(self) -> None:
        """Start anew."""
        self.count = 0

    def table(self) -> pa.Table:
        """Return what is kept, by step, then agent; it is good until the next change."""
        n_agents, kept = len(self._seeds), slice(self.count)
        columns = {
            "step": np.repeat(self._decisions[kept], n_agents),
            "agent": np.tile(np.arange(n_agents, dtype=np.int32), self.count),
            "seed": np.tile(self._seeds, self.count),
        }
        if self.has_zones:
            columns["zone"] = self._zones[kept].ravel()
        for field, names in self._names.items():
            block = self._values[field][kept].reshape(self.count * n_agents, len(names))
            columns |= dict(zip(names, block.T, strict=True))
        return pa.table({name: pa.array(c, from_pandas=True) for name, c in columns.items()})


def _column_names(space: SensorimotorSpace) -> dict[str, list[str]]:
    """Return the columns that each field of a step fills, in the order of the file."""

    def each(kind: str, dimensions: Sequence[Dimension]) -> list[str]:
        return [f"{kind}/{dimension.name}" for dimension in dimensions]

    return {
        "random_actions": ["random_action"],
        "actions": each("action", space.actions),
        "sensors": each("sensor", space.sensors),
        "outcomes": each("outcome", space.outcomes),
        "predictions": each("prediction", space.outcomes),
        "errors": ["error"],
        "expected_errors": ["expected_error"],
        "regions": ["region"],
        "progress": ["progress"],
    }


def _shadow_names(space: SensorimotorSpace, shadows: Sequence[str]) -> dict[str, list[str]]:
    """Return the columns that the predictions and the errors of each shadow fill, in order."""
    names = {}
    for shadow in shadows:
        predictions = f"shadow/{shadow}/prediction"
        names[predictions] = [f"{predictions}/{outcome.name}" for outcome in space.outcomes]
        names[shadow_error(shadow)] = [shadow_error(shadow)]
    return names


def _claim(folder: Path) -> None:
    """Make a folder ready for a run, unless it already holds one."""
    files = [path for path in (folder, *folder.parents) if path.is_file()]
    if files:
        raise NotADirectoryError(f"{folder} cannot be a run folder: {files[0]} is a file")
    held = any((folder / name).exists() for name in (CONFIG, REGIONS, SUMMARY))
    held = held or any(folder.glob("events.out.tfevents.*"))
    if held or (folder / STEPS).exists():
        raise FileExistsError(f"{folder} already holds a run; choose another folder")
    (folder / STEPS).mkdir(parents=True)


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    data = dump_json(content)
    replace(path, lambda temporary: temporary.write_bytes(data))


def _write_table(path: Path, table: pa.Table) -> None:
    # Dictionaries make floats slower to write and larger.
    few = [field.name for field in table.schema if not pa.types.is_floating(field.type)]
    replace(
        path,
        lambda to: pq.write_table(table, to, use_dictionary=few, compression="zstd"),
    )
