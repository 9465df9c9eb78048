"""What TensorBoard shows of a run while it goes on.

Shapes: `A` agents, `T` decisions.
"""

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import HistogramProto, Summary, SummaryMetadata
from torch.utils.tensorboard import FileWriter
from torch.utils.tensorboard.summary import custom_scalars

from torch_iac.agent import RegionSummary
from torch_iac.regions import NONE, Genealogy

N_REGIONS_SHOWN = 200
"""TensorBoard gets tags for so many regions of agent 0, the oldest; more would make it crawl."""

WINDOW_TAGS = {
    "progress": "progress/mean",
    "errors": "error/mean",
    "expected_errors": "error/expected",
}
"""The fields of a step whose means are logged, and where."""

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


class Dashboard:
    """Writes what TensorBoard shows: aggregates over all agents and, region by region, agent 0.

    Args:
        folder: Where to write.
        n_agents: How many agents there are.
        zone_names: The names of the world's zones; none if it has no zones.
    """

    def __init__(self, folder: Path, n_agents: int, zone_names: Sequence[str]) -> None:
        self._n_agents, self._zone_names = n_agents, zone_names
        self._window = _Window(len(zone_names))
        self._map = _ProgressMap()
        self._n_logs = 0
        self._undescribed = dict(DESCRIPTIONS)
        self._writer = FileWriter(str(folder))
        layout = custom_scalars(_layout(zone_names))  # type: ignore[no-untyped-call]
        self._writer.add_summary(layout)

    def tally(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Count in some decisions.

        Args:
            columns: The fields of their steps, each of shape `(T, A)`, and `zones` if the world
                has any.
        """
        self._window.add(columns)

    def log(
        self, n_decisions: int, regions: RegionSummary, genealogy: Callable[[], Genealogy]
    ) -> None:
        """Write what the decisions since the last log and the present regions have to tell.

        Args:
            n_decisions: How many decisions each agent has taken; there is at least one to tell of.
            regions: The present leaves.
            genealogy: Gives every region ever made; asked only when a picture is due.
        """
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
            values.append(self._value("progress/map", image=self._map.draw(genealogy())))
        self._writer.add_summary(Summary(value=values), n_decisions)

    def flush(self) -> None:
        """Write what the writer still keeps."""
        self._writer.flush()

    def close(self) -> None:
        """Write the rest; nothing can be logged any more."""
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

    def add(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Count in some decisions."""
        for field in self._sums:
            self._sums[field] += float(columns[field].sum(dtype=np.float64))
        if "zones" in columns:
            zones = columns["zones"].ravel()
            self._zone_counts += np.bincount(zones, minlength=len(self._zone_counts))
        self._n_rows += columns["errors"].size

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
