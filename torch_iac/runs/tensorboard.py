"""What TensorBoard shows of a run while it goes on.

Its first page sorts groups of tags by name and opens the first two only: those are `development`
and `error`, so that a user sees at once what the robot does and how well it predicts.

Shapes: `A` agents, `T` decisions.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary, SummaryMetadata
from torch.utils.tensorboard.summary import custom_scalars

from torch_iac.records import Genealogy, RegionSummary
from torch_iac.runs.event_file import EventFile
from torch_iac.runs.schema import EVENTS, USED_NETWORK, shadow_error
from torch_iac.runs.tensorboard_images import CalibrationChart, ProgressMap, histogram_of
from torch_iac.runs.window_sums import WindowSums

N_REGIONS_SHOWN = 200
"""Regions of agent 0 that have tags, the oldest; more would make TensorBoard slow."""

MEAN_TAGS = {
    "progress": "progress/mean",
    "error": "error/mean",
    "expected_error": "error/expected",
    USED_NETWORK: "development/network_share",
}
"""The columns of the steps whose means are logged, and where."""

N_TOP = 5
"""How many of the regions with most progress are followed by rank."""

LOGS_PER_PICTURE = 10
"""The histogram, the map and MP's calibration come every so many logs: they cost more than numbers.
"""

DESCRIPTIONS = {
    "development/map": "Learning progress of agent 0, from the start (left) to now (right). Each "
    "row is a present region, neighbours in the tree side by side; before its birth it shows its "
    "ancestors. Red: errors fall, blue: errors grow.",
    "development/n_regions": "How many regions an agent's cube is in, mean over the first agents.",
    "development/network_share": "Share of the last decisions in whose region hybrid experts used "
    "the network, over all agents.",
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
"""Descriptions of tags."""

PLUGINS = {"simple_value": "scalars", "histo": "histograms", "image": "images"}
"""TensorBoard's plugin for each kind of value."""


class Dashboard:
    """Writes what TensorBoard shows: aggregates over agents and, region by region, agent 0.

    Args:
        folder: Where to write.
        n_agents: The regions of how many agents it will be shown.
        zone_names: The names of the world's zones; none if it has no zones.
        shadows: The names of the shadow experts.
    """

    def __init__(
        self, folder: Path, n_agents: int, zone_names: Sequence[str], shadows: Sequence[str] = ()
    ) -> None:
        self._n_agents, self._zone_names = n_agents, zone_names
        self._tags = MEAN_TAGS | {shadow_error(name): f"error/{name}" for name in shadows}
        self._sums: WindowSums | None = None  # since the last log
        self._calibration = CalibrationChart()
        self._map = ProgressMap()
        self._n_logs = 0
        self._undescribed = DESCRIPTIONS | _descriptions(zone_names, shadows)
        self._folder, self._older = folder, set(folder.glob(EVENTS))
        self._writer = EventFile(folder)
        layout = custom_scalars(_layout(zone_names))  # type: ignore[no-untyped-call]
        self._writer.add_summary(layout)

    def add(self, sums: WindowSums, columns: Mapping[str, NDArray[Any]]) -> None:
        """Count in some decisions.

        Args:
            sums: What all agents did, shape `(A, Z)`.
            columns: `errors` and `expected_errors` of some agents, each of shape `(T, A)`.
        """
        self._sums = sums if self._sums is None else self._sums + sums
        self._calibration.add(columns)

    def log(
        self, n_decisions: int, regions: RegionSummary, genealogy: Callable[[], Genealogy]
    ) -> None:
        """Log the decisions since the last log, and the present regions.

        Args:
            n_decisions: How many decisions each agent has taken; at least one since the last log.
            regions: The present leaves of the agents whose regions are shown.
            genealogy: Gives every region ever made; asked only when a picture is due.
        """
        own = regions.agent.numpy() == 0
        scalars = {} if self._sums is None else _means(self._sums, self._tags, self._zone_names)
        self._sums = None
        scalars |= _over_agents(regions, self._n_agents)
        scalars |= _top(regions.progress.numpy()[own]) | _by_region(regions, own)
        values = [self._value(tag, simple_value=value) for tag, value in scalars.items()]
        self._map.add(regions.region.numpy()[own], regions.progress.numpy()[own])
        self._n_logs += 1
        if self._n_logs % LOGS_PER_PICTURE == 0:
            histogram = histogram_of(regions.progress.numpy())
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
        """Return the whole state, and the sizes of the files on disk."""
        self.flush()
        sums = self._sums
        return {
            "sums": None if sums is None else [sums.counts, sums.sums],
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
        if self._older:  # a running TensorBoard drops what was logged later, too
            restart = SessionLog(status=SessionLog.START)
            self._writer.add_event(Event(session_log=restart), step=n_decisions + 1)
        if state:
            self._sums = WindowSums(*state["sums"]) if state["sums"] else None
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
    """Return the descriptions of the tags of each zone, rank and shadow."""
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


def _means(
    sums: WindowSums, tags: Mapping[str, str], zone_names: Sequence[str]
) -> dict[str, float]:
    """Return the means over agents, as far as there are any, and the share of each zone."""
    zones = sums.total(0)
    whole = zones.total(1)
    means = {tag: whole.means(of).item() for of, tag in tags.items() if of in sums.sums}
    shares = (zones.counts / whole.counts)[0].tolist()
    by_zone = zip(zone_names, shares, strict=False)
    means |= {f"development/time_in_{name}": share for name, share in by_zone}
    if np.isfinite(means["error/expected"]):
        for column, kind in (("expected_error", "expected"), ("error", "actual")):
            by_zone = zip(zone_names, zones.means(column)[0].tolist(), strict=False)
            means |= {f"mp_calibration/{name}/{kind}": mean for name, mean in by_zone}
    return {tag: mean for tag, mean in means.items() if np.isfinite(mean)}


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


def _layout(zone_names: Sequence[str]) -> dict[str, dict[str, tuple[str, list[str]]]]:
    """Return the charts of TensorBoard's page of custom scalars; tags are regular expressions."""
    charts = {
        "Share of time in each zone": ["development/time_in_.*"] if zone_names else [],
        "Learning progress of the best regions": ["top_progress/.*"],
        "Prediction errors: the experts, what MP expected of them, their shadows": ["error/.*"],
        "Number of regions": ["development/n_regions"],
    }
    return {"Development": {title: ("Multiline", tags) for title, tags in charts.items() if tags}}
