"""What a run leaves behind: its decisions, its regions, TensorBoard, a summary.

Every file is written under a temporary name, fsynced and renamed, so whatever has its final name is
whole, also after a crash. Shapes: `A` agents, `T` decisions in one part, `S` regions.
"""

import io
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import matplotlib as mpl
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import HistogramProto, Summary, SummaryMetadata
from torch import Tensor
from torch.utils.tensorboard import FileWriter
from torch.utils.tensorboard.summary import custom_scalars

from torch_iac.agent import RegionSummary, Step
from torch_iac.regions import NONE, Genealogy
from torch_iac.runs import CONFIG, REGIONS, STEPS, SUMMARY, load_run, part_path, summarise
from torch_iac.space import Dimension, SensorimotorSpace

DECISIONS_PER_PART = 2000
"""A part is written after so many decisions, or earlier in a large population."""

N_REGIONS_SHOWN = 200
"""TensorBoard gets tags for so many regions of agent 0, the oldest; more would make it crawl."""

WINDOW_TAGS = {
    "progress": "progress/mean",
    "errors": "error/mean",
    "expected_errors": "error/expected",
}
"""The fields of a step whose means are logged, and where."""

DTYPES = {
    "random_actions": np.bool_,
    "errors": np.float64,
    "expected_errors": np.float32,
    "regions": np.int32,
    "progress": np.float64,
}
"""The fields of a step that are one number an agent; the rest are vectors in raw units, float32."""

N_TOP = 5
"""How many of the regions with most progress are followed by rank."""

LOGS_PER_PICTURE = 10
"""The histogram and the map are drawn every so many logs: they cost more than numbers."""

MAP_COLUMNS = 256
"""How many moments the map holds; when it is full, every other one is dropped."""

MAP_PIXELS = (384, 640)
"""Height and width of the map."""

DESCRIPTIONS = {
    "progress/mean": "Mean learning progress of the regions that predicted the last decisions, "
    "over all agents.",
    "progress/best": "Learning progress of the best region, mean over all agents.",
    "progress/regions": "Learning progress of every present region of every agent.",
    "progress/map": "Learning progress of agent 0, from the start (left) to now (right). Each row "
    "is a present region, neighbours in the tree side by side; before its birth it shows its "
    "ancestors. Red: errors fall, blue: errors grow.",
    "error/mean": "Mean prediction error of the last decisions, over all agents, in scaled units.",
    "error/expected": "What the meta-predictor expected it to be.",
    "regions/number": "How many regions an agent's cube is in, mean over all agents.",
}

PLUGINS = {"simple_value": "scalars", "histo": "histograms", "image": "images"}
"""Which part of TensorBoard shows which kind of value."""


class Recorded(Protocol):
    """What a recorder asks of the agent that it records; `IAC` has it."""

    @property
    def space(self) -> SensorimotorSpace:
        """What the agents do, sense and predict."""

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each agent."""

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
        config: What else `config.json` shall hold, besides the space, the seeds and the zones.
        log_every: How many decisions lie between two logs to TensorBoard.
        rows_per_part: At most so many rows (a decision of an agent) are kept in memory.

    Raises:
        FileExistsError: The folder already holds a run; it is not touched.
        ValueError: `log_every` or `rows_per_part` is below 1.
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
        self.folder = Path(folder)
        _claim(self.folder)
        known = {"space": agent.space.to_json(), "seeds": agent.seeds, "zones": zone_names}
        write_config(self.folder, {**(config or {}), **known})
        n_decisions = max(1, min(DECISIONS_PER_PART, rows_per_part // len(agent.seeds)))
        self._agent, self._log_every = agent, log_every
        self._rows = _Rows(n_decisions, agent.space, agent.seeds, zone_names is not None)
        self._n_parts = self._n_tallied = 0
        self._dashboard = _Dashboard(self.folder, len(agent.seeds), zone_names or ())
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
            self._dashboard.log(step.number + 1, self._agent)
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
        self._dashboard.tally(self._rows, self._n_tallied)
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
        self, capacity: int, space: SensorimotorSpace, seeds: Sequence[int], has_zones: bool
    ) -> None:
        self.count, self.has_zones = 0, has_zones
        self._seeds = np.array(seeds, np.int64)
        self._decisions = np.empty(capacity, np.int64)
        self._zones = np.empty((capacity, len(seeds)), np.int8)
        self._names = _column_names(space)
        self._fields_of = attrgetter(*self._names)
        shape = (capacity, len(seeds))
        self._values: dict[str, NDArray[Any]] = {
            field: np.empty(shape, DTYPES[field])
            if field in DTYPES
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
        for tensor, values in zip(self._fields_of(step), self._values.values(), strict=True):
            values[self.count] = np.nan if tensor is None else tensor.numpy(force=True)
        self.count += 1

    def since(self, start: int, field: str) -> NDArray[Any]:
        """Return a field of the decisions kept at `start` and later, shape `(T, A, ...)`."""
        return self._values[field][start : self.count]

    def zones_since(self, start: int) -> NDArray[np.int8]:
        """Return the zones of the decisions kept at `start` and later, shape `(T, A)`."""
        return self._zones[start : self.count]

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


class _Dashboard:
    """What TensorBoard shows while the run goes on."""

    def __init__(self, folder: Path, n_agents: int, zone_names: Sequence[str]) -> None:
        self._n_agents, self._zone_names = n_agents, zone_names
        self._window = _Window(len(zone_names))
        self._map = _ProgressMap()
        self._n_logs = 0
        self._undescribed = dict(DESCRIPTIONS)
        self._writer = FileWriter(str(folder))
        layout = custom_scalars(_layout(zone_names))  # type: ignore[no-untyped-call]
        self._writer.add_summary(layout)

    def tally(self, rows: _Rows, start: int) -> None:
        """Count in the decisions kept at `start` and later."""
        self._window.add(rows, start)

    def log(self, n_decisions: int, agent: Recorded) -> None:
        """Write what the decisions since the last log and the present regions have to tell."""
        regions = agent.region_summary()
        own = regions.agent.numpy() == 0
        scalars = self._window.means(self._zone_names)
        self._window = _Window(len(self._zone_names))
        scalars |= _over_agents(regions, self._n_agents)
        scalars |= _top(regions.progress.numpy()[own]) | _by_region(regions, own)
        values = [self._value(tag, simple_value=value) for tag, value in scalars.items()]
        self._map.add(regions.region.numpy()[own], regions.progress.numpy()[own])
        self._n_logs += 1
        if self._n_logs % LOGS_PER_PICTURE == 0:
            histogram = _histogram(regions.progress.numpy())
            values.append(self._value("progress/regions", histo=histogram))
            values.append(self._value("progress/map", image=self._map.draw(agent.genealogy())))
        self._writer.add_summary(Summary(value=values), n_decisions)

    def flush(self) -> None:
        self._writer.flush()

    def close(self) -> None:
        self._writer.close()

    def _value(self, tag: str, **content: Any) -> Summary.Value:
        """Return one value; the first of its tag comes with a description, if there is one."""
        if tag not in self._undescribed:
            return Summary.Value(tag=tag, **content)
        plugin = SummaryMetadata.PluginData(plugin_name=PLUGINS[next(iter(content))])
        about = SummaryMetadata(summary_description=self._undescribed.pop(tag), plugin_data=plugin)
        return Summary.Value(tag=tag, metadata=about, **content)


class _Window:
    """Sums over the decisions since the last log."""

    def __init__(self, n_zones: int) -> None:
        self._sums = dict.fromkeys(WINDOW_TAGS, 0.0)
        self._zone_counts = np.zeros(n_zones, np.int64)
        self._n_rows = 0

    def add(self, rows: _Rows, start: int) -> None:
        """Count in the decisions kept at `start` and later."""
        for field in self._sums:
            self._sums[field] += float(rows.since(start, field).sum(dtype=np.float64))
        if rows.has_zones:
            zones = rows.zones_since(start).ravel()
            self._zone_counts += np.bincount(zones, minlength=len(self._zone_counts))
        self._n_rows += rows.since(start, "errors").size

    def means(self, zone_names: Sequence[str]) -> dict[str, float]:
        """Return the means, as far as there are any, and the share of each zone."""
        means = {WINDOW_TAGS[field]: total / self._n_rows for field, total in self._sums.items()}
        shares = (self._zone_counts / self._n_rows).tolist()
        known = {tag: mean for tag, mean in means.items() if np.isfinite(mean)}
        return known | {f"zones/{z}": share for z, share in zip(zone_names, shares, strict=True)}


def _over_agents(regions: RegionSummary, n_agents: int) -> dict[str, float]:
    """Return measures of the present regions, each the mean over all agents."""
    best = np.full(n_agents, -np.inf)
    np.maximum.at(best, regions.agent.numpy(), regions.progress.numpy())
    return {
        "progress/best": float(best.mean()),
        "regions/number": len(regions.agent) / n_agents,
    }


def _top(progress: NDArray[np.float64]) -> dict[str, float]:
    """Return the progress of one agent's best regions, by rank."""
    best = np.sort(progress)[::-1][:N_TOP].tolist()
    return {f"top_progress/{rank}": value for rank, value in enumerate(best, start=1)}


def _by_region(regions: RegionSummary, chosen: NDArray[np.bool_]) -> dict[str, float]:
    """Return the progress and the mean error of each chosen region, as far as they are shown."""
    chosen = chosen & (regions.region.numpy() < N_REGIONS_SHOWN)
    names = regions.region.numpy()[chosen].tolist()
    scalars: dict[str, float] = {}
    for tag, column in (
        ("region_progress", regions.progress),
        ("region_error", regions.mean_error),
    ):
        values = column.numpy()[chosen].tolist()
        scalars |= {f"{tag}/{n:04d}": v for n, v in zip(names, values, strict=True) if v == v}
    return scalars


class _ProgressMap:
    """An agent's learning progress, region by region, over the whole run, in bounded memory."""

    def __init__(self) -> None:
        self._moments: list[tuple[NDArray[np.int64], NDArray[np.float64]]] = []
        self._stride = 1
        self._n_added = 0

    def add(self, regions: NDArray[np.int64], progress: NDArray[np.float64]) -> None:
        """Keep the progress of the regions that are there now."""
        if self._n_added % self._stride == 0:
            self._moments.append((regions, progress))
        self._n_added += 1
        if len(self._moments) == MAP_COLUMNS:
            self._moments, self._stride = self._moments[::2], self._stride * 2

    def draw(self, genealogy: Genealogy) -> Summary.Image:
        """Return the map as it is now; before a region was born, its row shows its ancestors."""
        own = genealogy.agent.numpy() == 0
        parents = genealogy.parent.numpy()[own].tolist()
        leaves = np.flatnonzero(genealogy.split_step.numpy()[own] == NONE)
        rows = sorted(leaves.tolist(), key=_paths(parents).__getitem__)
        return _image(self._lines_of_descent(parents)[rows])

    def _lines_of_descent(self, parents: list[int]) -> NDArray[np.float64]:
        """Return each region's progress at each moment, its ancestors' before it was born."""
        lines = np.full((len(parents), len(self._moments)), np.nan)
        for moment, (regions, progress) in enumerate(self._moments):
            lines[regions, moment] = progress
        for region, parent in enumerate(parents):  # parents come before their children
            if parent != NONE:
                lines[region] = np.where(np.isnan(lines[region]), lines[parent], lines[region])
        return lines


def _paths(parents: list[int]) -> list[str]:
    """Return the way from the root to each region: 0 for left, 1 for right, cut by cut."""
    paths = [""] * len(parents)
    has_left = set()
    for region, parent in enumerate(parents):
        if parent != NONE:
            paths[region] = paths[parent] + ("1" if parent in has_left else "0")
            has_left.add(parent)
    return paths


def _image(progress: NDArray[np.float64]) -> Summary.Image:
    """Return a picture of rows of progress: white is none, red positive, blue negative."""
    scale = float(np.abs(progress).max()) or 1.0
    rows, columns = (
        np.arange(size) * n // size for n, size in zip(progress.shape, MAP_PIXELS, strict=True)
    )
    shades = np.round(127.5 + 127.5 * progress / scale).astype(np.uint8)
    picture = Image.fromarray(shades[np.ix_(rows, columns)])
    picture.putpalette(mpl.colormaps["RdBu_r"](np.arange(256), bytes=True)[:, :3].tobytes())
    png = io.BytesIO()
    picture.save(png, format="png", compress_level=1)
    height, width = MAP_PIXELS
    return Summary.Image(
        height=height, width=width, colorspace=3, encoded_image_string=png.getvalue()
    )


def _histogram(values: NDArray[np.float64]) -> HistogramProto:
    counts, edges = np.histogram(values, bins=30)
    return HistogramProto(
        min=values.min(),
        max=values.max(),
        num=len(values),
        sum=values.sum(),
        sum_squares=values @ values,
        bucket_limit=edges[1:],
        bucket=counts,
    )


def _layout(zone_names: Sequence[str]) -> dict[str, dict[str, tuple[str, list[str]]]]:
    """Return the charts of TensorBoard's page of custom scalars."""
    charts = {
        "Share of time in each zone": [f"zones/{name}" for name in zone_names],
        "Learning progress of the best regions": [f"top_progress/{r}" for r in range(1, N_TOP + 1)],
        "Prediction error, and what MP expected": ["error/mean", "error/expected"],
        "Number of regions": ["regions/number"],
    }
    return {"Development": {title: ("Multiline", tags) for title, tags in charts.items() if tags}}


def _claim(folder: Path) -> None:
    """Make a folder ready for a run, unless it already holds one."""
    held = any((folder / name).exists() for name in (CONFIG, REGIONS, SUMMARY))
    held = held or any(folder.glob("events.out.tfevents.*"))
    if held or (folder / STEPS).exists():
        raise FileExistsError(f"{folder} already holds a run; choose another folder")
    (folder / STEPS).mkdir(parents=True)


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    _replace(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _write_table(path: Path, table: pa.Table) -> None:
    # Dictionaries make floats slower to write and larger.
    few = [field.name for field in table.schema if not pa.types.is_floating(field.type)]
    _replace(
        path,
        lambda to: pq.write_table(table, to, use_dictionary=few, compression="zstd"),
    )


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file so that, at every moment, its name holds the old content or the new, whole."""
    temporary = path.with_name(f".{path.name}.tmp")
    write(temporary)
    _sync(temporary)
    temporary.replace(path)
    if os.name == "posix":  # elsewhere a folder cannot be opened
        _sync(path.parent)


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
