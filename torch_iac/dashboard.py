"""What TensorBoard shows of a run while it goes on.

Its first page sorts groups of tags by name and opens the first two only: those are `development`
and `error`, so that a user sees at once what the robot does and how well it predicts.

Shapes: `A` agents, `T` decisions.
"""

import io
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import HistogramProto, Summary, SummaryMetadata
from torch.utils.tensorboard import FileWriter
from torch.utils.tensorboard.summary import custom_scalars

from torch_iac.agent import RegionSummary
from torch_iac.regions import NONE, Genealogy
from torch_iac.runs import EVENTS, by_decile, shadow_error
from torch_iac.tallies import Tally

N_REGIONS_SHOWN = 200
"""TensorBoard gets tags for so many regions of agent 0, the oldest; more would make it crawl."""

TALLY_TAGS = {
    "progress": "progress/mean",
    "error": "error/mean",
    "expected_error": "error/expected",
}
"""The columns of the steps whose means are logged, and where."""

N_TOP = 5
"""How many of the regions with most progress are followed by rank."""

LOGS_PER_PICTURE = 10
"""The histogram, the map and MP's calibration come every so many logs: they cost more than numbers.
"""

MAP_COLUMNS = 256
"""How many moments the map holds; when it is full, every other one is dropped."""

MAP_PIXELS = (384, 640)
"""Height and width of the map."""

N_CALIBRATED = 1000
"""Over how many of the last decisions of an agent the picture of MP's calibration goes."""

N_AGENTS_CALIBRATED = 64
"""It goes over so many agents, the first."""

CALIBRATION_PIXELS = 320
"""Its height and its width."""

LEAST_ERROR = 1e-6
"""It shows smaller errors at its lower end, since it has logarithmic axes."""

DESCRIPTIONS = {
    "development/map": "Learning progress of agent 0, from the start (left) to now (right). Each "
    "row is a present region, neighbours in the tree side by side; before its birth it shows its "
    "ancestors. Red: errors fall, blue: errors grow.",
    "development/n_regions": "How many regions an agent's cube is in, mean over the first agents.",
    "progress/mean": "Mean learning progress of the regions that predicted the last decisions, "
    "over all agents.",
    "progress/best": "Learning progress of the best region, mean over the first agents.",
    "progress/regions": "Learning progress of every present region of the first agents.",
    "error/mean": "Mean prediction error of the last decisions, over all agents, in scaled units.",
    "error/expected": "What the meta-predictor expected it to be.",
    "mp_calibration/deciles": "Of the last decisions, those with the lowest tenth of the errors "
    "that the meta-predictor expected, the next tenth and so on: what it expected on average, and "
    "what the error was. A calibrated one keeps to the diagonal.",
}
"""What is said of tags, beside them."""

PLUGINS = {"simple_value": "scalars", "histo": "histograms", "image": "images"}
"""Which part of TensorBoard shows which kind of value."""


class Dashboard:
    """Writes what TensorBoard shows: aggregates over agents and, region by region, agent 0.

    Args:
        folder: Where to write.
        n_agents: The regions of how many agents it will be shown.
        zone_names: The names of the world's zones; none if it has no zones.
        shadows: The names of the experts that only look on.
    """

    def __init__(
        self, folder: Path, n_agents: int, zone_names: Sequence[str], shadows: Sequence[str] = ()
    ) -> None:
        self._n_agents, self._zone_names = n_agents, zone_names
        self._tags = TALLY_TAGS | {shadow_error(name): f"error/{name}" for name in shadows}
        self._tally: Tally | None = None  # since the last log
        self._calibration = _Calibration()
        self._map = _ProgressMap()
        self._n_logs = 0
        self._undescribed = DESCRIPTIONS | _descriptions(zone_names, shadows)
        self._folder, self._older = folder, set(folder.glob(EVENTS))
        self._writer = FileWriter(str(folder))
        layout = custom_scalars(_layout(zone_names))  # type: ignore[no-untyped-call]
        self._writer.add_summary(layout)

    def tally(self, tally: Tally, columns: Mapping[str, NDArray[Any]]) -> None:
        """Count in some decisions.

        Args:
            tally: What all agents did, shape `(A, Z)`.
            columns: `errors` and `expected_errors` of some agents, each of shape `(T, A)`.
        """
        self._tally = tally if self._tally is None else self._tally + tally
        self._calibration.add(columns)

    def log(
        self, n_decisions: int, regions: RegionSummary, genealogy: Callable[[], Genealogy]
    ) -> None:
        """Write what the decisions since the last log and the present regions have to tell.

        Args:
            n_decisions: How many decisions each agent has taken; there is at least one to tell of.
            regions: The present leaves of the agents whose regions are shown.
            genealogy: Gives every region ever made; asked only when a picture is due.
        """
        own = regions.agent.numpy() == 0
        scalars = {} if self._tally is None else _means(self._tally, self._tags, self._zone_names)
        self._tally = None
        scalars |= _over_agents(regions, self._n_agents)
        scalars |= _top(regions.progress.numpy()[own]) | _by_region(regions, own)
        values = [self._value(tag, simple_value=value) for tag, value in scalars.items()]
        self._map.add(regions.region.numpy()[own], regions.progress.numpy()[own])
        self._n_logs += 1
        if self._n_logs % LOGS_PER_PICTURE == 0:
            histogram = _histogram(regions.progress.numpy())
            values.append(self._value("progress/regions", histo=histogram))
            values.append(self._value("development/map", image=self._map.draw(genealogy())))
            if self._calibration.is_known:
                picture = self._calibration.draw()
                values.append(self._value("mp_calibration/deciles", image=picture))
        self._writer.add_summary(Summary(value=values), n_decisions)

    def flush(self) -> None:
        """Write what the writer still keeps."""
        self._writer.flush()

    def state(self) -> dict[str, Any]:
        """Return all that goes on, and how far the files on disk go."""
        self.flush()
        tally = self._tally
        return {
            "tally": None if tally is None else [tally.counts, tally.sums],
            "calibration": self._calibration.state(),
            "map": self._map.state(),
            "n_logs": self._n_logs,
            "files": {path.name: path.stat().st_size for path in self._folder.glob(EVENTS)},
        }

    def load_state(self, state: Mapping[str, Any] | None, n_decisions: int) -> None:
        """Go on from what `state` returned, or from nothing; what was logged later is dropped.

        Args:
            state: What `state` returned; None to start anew.
            n_decisions: How many decisions had been taken then.
        """
        files = state["files"] if state else {}
        for path in self._older:
            if path.name not in files:
                path.unlink()
            elif path.stat().st_size > files[path.name]:
                os.truncate(path, files[path.name])
        if self._older:  # a TensorBoard that looks on forgets what was logged later, too
            restart = SessionLog(status=SessionLog.START)
            self._writer.add_event(Event(session_log=restart), step=n_decisions + 1)
        if state:
            self._tally = Tally(*state["tally"]) if state["tally"] else None
            self._calibration.load_state(state["calibration"])
            self._map.load_state(state["map"])
            self._n_logs = state["n_logs"]

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


def _descriptions(zone_names: Sequence[str], shadows: Sequence[str]) -> dict[str, str]:
    """Return what is said of the tags of each zone, rank and shadow."""
    texts = {f"error/{name}": f"Mean prediction error of the shadow {name}." for name in shadows}
    for rank in range(1, N_TOP + 1):
        texts[f"top_progress/{rank}"] = (
            f"Learning progress of the region of agent 0 that is number {rank} by it now."
        )
    for name in zone_names:
        texts |= {
            f"development/time_in_{name}": f"Share of the last decisions in {name}, over all "
            "agents.",
            f"mp_calibration/{name}/expected": "Mean error that the meta-predictor expected of "
            f"the last decisions in {name}.",
            f"mp_calibration/{name}/actual": f"Mean error of the last decisions in {name}.",
        }
    return texts


def _means(tally: Tally, tags: Mapping[str, str], zone_names: Sequence[str]) -> dict[str, float]:
    """Return the means over agents, as far as there are any, and the share of each zone."""
    zones = tally.total(0)
    whole = zones.total(1)
    means = {tag: whole.means(column).item() for column, tag in tags.items()}
    shares = (zones.counts / whole.counts)[0].tolist()
    by_zone = zip(zone_names, shares, strict=False)
    means |= {f"development/time_in_{name}": share for name, share in by_zone}
    if np.isfinite(means["error/expected"]):
        for column, kind in (("expected_error", "expected"), ("error", "actual")):
            by_zone = zip(zone_names, zones.means(column)[0].tolist(), strict=False)
            means |= {f"mp_calibration/{name}/{kind}": mean for name, mean in by_zone}
    return {tag: mean for tag, mean in means.items() if np.isfinite(mean)}


class _Calibration:
    """What MP expected of the last decisions of the first agents, and what came of them."""

    def __init__(self) -> None:
        self._expected, self._actual = np.empty((0, 0)), np.empty((0, 0))

    @property
    def is_known(self) -> bool:
        return bool(self._expected.size)

    def add(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Keep some decisions, if there is an MP."""
        expected = columns["expected_errors"][-N_CALIBRATED:, :N_AGENTS_CALIBRATED]
        if np.isnan(expected).all():
            return
        actual = columns["errors"][-N_CALIBRATED:, :N_AGENTS_CALIBRATED]
        kept = slice(-N_CALIBRATED, None)
        if self.is_known:
            expected = np.concatenate([self._expected, expected])[kept]
            actual = np.concatenate([self._actual, actual])[kept]
        # Copies, since the columns are reused.
        self._expected, self._actual = expected.copy(), actual.copy()

    def state(self) -> list[NDArray[Any]]:
        """Return what is kept."""
        return [self._expected, self._actual]

    def load_state(self, state: list[NDArray[Any]]) -> None:
        """Go on from what `state` returned."""
        self._expected, self._actual = state

    def draw(self) -> Summary.Image:
        """Return a picture of the mean error by decile of the expectation."""
        return _decile_picture(np.stack(by_decile(self._expected, self._actual)))


def _over_agents(regions: RegionSummary, n_agents: int) -> dict[str, float]:
    """Return measures of the present regions, each the mean over all agents."""
    best = np.full(n_agents, -np.inf)
    np.maximum.at(best, regions.agent.numpy(), regions.progress.numpy())
    return {
        "progress/best": float(best.mean()),
        "development/n_regions": len(regions.agent) / n_agents,
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

    def state(self) -> dict[str, Any]:
        """Return the moments that are kept, one after the other, and how they are chosen."""
        lengths = [len(regions) for regions, _ in self._moments]
        regions, progress = ([moment[i] for moment in self._moments] for i in (0, 1))
        return {
            "lengths": np.array(lengths, np.int64),
            "regions": np.concatenate([np.empty(0, np.int64), *regions]),
            "progress": np.concatenate([np.empty(0), *progress]),
            "stride": self._stride,
            "n_added": self._n_added,
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` returned."""
        ends = state["lengths"].cumsum()[:-1]
        columns = (np.split(state[name], ends) for name in ("regions", "progress"))
        self._moments = list(zip(*columns, strict=True)) if len(state["lengths"]) else []
        self._stride, self._n_added = state["stride"], state["n_added"]

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
    from matplotlib import colormaps  # it takes long to import, and little is needed of it

    scale = float(np.abs(progress).max()) or 1.0
    rows, columns = (
        np.arange(size) * n // size for n, size in zip(progress.shape, MAP_PIXELS, strict=True)
    )
    shades = np.round(127.5 + 127.5 * progress / scale).astype(np.uint8)
    picture = Image.fromarray(shades[np.ix_(rows, columns)])
    picture.putpalette(colormaps["RdBu_r"](np.arange(256), bytes=True)[:, :3].tobytes())
    return _png(picture)


def _decile_picture(deciles: NDArray[np.float64]) -> Summary.Image:
    """Return expected and actual errors, shape `(2, 10)`, as a curve on logarithmic axes."""
    powers = np.log10(np.maximum(deciles, LEAST_ERROR))
    powers = powers[:, np.isfinite(powers).all(axis=0)]
    low, high = math.floor(powers.min()), math.floor(powers.max()) + 1
    size, margin = CALIBRATION_PIXELS, CALIBRATION_PIXELS // 8
    scale = (size - 1.5 * margin) / (high - low)
    start, end = margin, size - margin // 2  # from left to right; upside down from bottom to top
    picture = Image.new("RGB", (size, size), "white")
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(11)
    for power in range(low, high + 1):
        at, label = margin + (power - low) * scale, f"{10.0**power:g}"
        pen.line([(at, size - start), (at, size - end)], "#DDDDDD")
        pen.line([(start, size - at), (end, size - at)], "#DDDDDD")
        pen.text((at, size - start + 4), label, "black", font, "ma")
        pen.text((start - 4, size - at), label, "black", font, "rm")
    pen.line([(start, size - start), (end, size - end)], "#999999", 2)
    pen.text((end, size - 4), "expected error", "black", font, "rd")
    pen.text((start, size - end - 4), "actual error", "black", font, "ld")
    expected, actual = margin + (powers - low) * scale
    points = list(zip(expected.tolist(), (size - actual).tolist(), strict=True))
    pen.line(points, "#0072B2", 2)
    for x, y in points:
        pen.ellipse([x - 4, y - 4, x + 4, y + 4], "#0072B2")
    return _png(picture)


def _png(picture: Image.Image) -> Summary.Image:
    png = io.BytesIO()
    picture.save(png, format="png", compress_level=1)
    return Summary.Image(
        height=picture.height,
        width=picture.width,
        colorspace=3,
        encoded_image_string=png.getvalue(),
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
    """Return the charts of TensorBoard's page of custom scalars; tags are regular expressions."""
    charts = {
        "Share of time in each zone": ["development/time_in_.*"] if zone_names else [],
        "Learning progress of the best regions": ["top_progress/.*"],
        "Prediction errors: the experts, what MP expected of them, their shadows": ["error/.*"],
        "Number of regions": ["development/n_regions"],
    }
    return {"Development": {title: ("Multiline", tags) for title, tags in charts.items() if tags}}
