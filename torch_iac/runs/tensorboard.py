"""What TensorBoard shows of a run while it goes on.

Its first page sorts groups of tags by name and opens the first two only: those are `development`
and `learning_progress`, so that a user sees at once what the robot does and where it learns. Within
a group, curves come before what has a card for each run (`view_...`, `region ...`): a comparison of
many runs begins with curves.

Shapes: `A` agents, `T` decisions, `Z` zones.
"""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary, SummaryMetadata
from torch.utils.tensorboard.summary import custom_scalars

from torch_iac.records import Genealogy, RegionSummary
from torch_iac.regions.tree import NONE
from torch_iac.runs.event_file import EventFile
from torch_iac.runs.followed_regions import Family, Followed, Visits
from torch_iac.runs.schema import EVENTS, USED_NETWORK, shadow_error
from torch_iac.runs.tensorboard_images import (
    ERRORS,
    PROGRESS,
    CalibrationChart,
    RegionHistory,
    Scene,
    ZoneHistory,
    histogram_of,
)
from torch_iac.runs.window_sums import WindowSums
from torch_iac.space import SensorimotorSpace

MEAN_TAGS = {
    "progress": "learning_progress/mean",
    "error": "prediction_error/mean",
    "expected_error": "prediction_error/expected",
    USED_NETWORK: "development/network_share",
}
"""The columns of the steps whose means are logged, and where."""

EARLY_PICTURES, LOGS_PER_PICTURE = (1, 2, 5), 10
"""Pictures come at these first logs and then every so many: they cost more than numbers. Then it is
also chosen which regions have curves."""

DESCRIPTIONS = {
    "development/view_figure_2": "Figure 2 of the paper: the mean error of each region of agent 0, "
    "from its birth to its cut, in the colour of the zone where its decisions were. Regions with a "
    "curve in learning_progress/ are in bold, with their number.",
    "development/view_figure_3": "Figure 3 of the paper: the share of decisions in each zone, over "
    "all agents.",
    "development/view_map": "Learning progress of agent 0. Each row is a present region, "
    "neighbours in the tree side by side; before its birth it shows its ancestors. Blue: errors "
    "fall, vermillion: errors grow. At the right, the zone of each region, and the numbers of "
    "those with a curve in learning_progress/.",
    "development/n_regions": "How many regions an agent's cube is in, mean over the first agents.",
    "development/network_share": "Share of the last decisions in whose region hybrid experts used "
    "the network, over all agents.",
    "learning_progress/best": "Learning progress of the best region, mean over the first agents.",
    "development/view_progress": "Learning progress of each region of agent 0, as figure 2 has "
    "errors.",
    "learning_progress/spread": "Learning progress of every present region of the first agents.",
    "learning_progress/mean": "Mean learning progress of the regions that predicted the last "
    "decisions, over all agents.",
    "prediction_error/mean": "Mean prediction error of the last decisions, over all agents, in "
    "scaled units.",
    "prediction_error/expected": "What the meta-predictor expected it to be.",
    "mp_calibration/deciles": "Of the last decisions, those with the lowest tenth of the errors "
    "that the meta-predictor expected, the next tenth and so on: what it expected on average, and "
    "what the error was. A calibrated one keeps to the diagonal.",
}
"""Descriptions of tags."""

OF_REGION = (
    "of a region of agent 0. Its name has its number, the zone where most of its decisions were, "
    "the cut that made it and the region that was cut. The curve ends where the region is cut, or "
    "when the robot has left it."
)
"""How the descriptions of a region's curves end."""

CURVES = ("Learning progress", "Mean error")
"""What a region's curves show."""

PLUGINS = {"simple_value": "scalars", "histo": "histograms", "image": "images"}
"""TensorBoard's plugin for each kind of value."""


class Dashboard:
    """Writes what TensorBoard shows: aggregates over agents and, region by region, agent 0.

    Args:
        folder: Where to write.
        space: What the robots do, sense and predict.
        n_agents: The regions of how many agents it will be shown.
        zone_names: The names of the world's zones; none if it has no zones.
        shadows: The names of the shadow experts.
    """

    def __init__(
        self,
        folder: Path,
        space: SensorimotorSpace,
        n_agents: int,
        zone_names: Sequence[str],
        shadows: Sequence[str] = (),
    ) -> None:
        self._n_agents, self._zone_names = n_agents, zone_names
        errors = {shadow_error(name): f"prediction_error/{name}" for name in shadows}
        self._tags = MEAN_TAGS | errors
        self._sums: WindowSums | None = None  # since the last log
        self._calibration = CalibrationChart()
        self._visits = Visits(len(zone_names))
        self._followed = Followed(space, zone_names)
        self._regions, self._zones = RegionHistory(), ZoneHistory()
        self._n_logs = 0
        self._undescribed = DESCRIPTIONS | _descriptions(zone_names, shadows)
        self._folder, self._older = folder, set(folder.glob(EVENTS))
        self._writer = EventFile(folder)
        layout = custom_scalars(_layout(zone_names, shadows))  # type: ignore[no-untyped-call]
        self._writer.add_summary(layout)

    def add(self, sums: WindowSums, columns: Mapping[str, NDArray[Any]]) -> None:
        """Count in some decisions.

        Args:
            sums: What all agents did, shape `(A, Z)`.
            columns: `errors`, `expected_errors`, `regions` and, in a world with zones, `zones` of
                some agents, each of shape `(T, A)`.
        """
        self._sums = sums if self._sums is None else self._sums + sums
        self._calibration.add(columns)
        zones = columns["zones"][:, 0] if self._zone_names else None
        self._visits.add(columns["regions"][:, 0], zones)

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
        of_own = [of.numpy()[own] for of in (regions.region, regions.progress, regions.mean_error)]
        scalars = _over_agents(regions, self._n_agents)
        if self._sums is not None:
            scalars |= _means(self._sums, self._tags, self._zone_names)
            self._zones.add(n_decisions, self._sums.counts.sum(axis=0))
        self._sums = None
        self._regions.add(n_decisions, *of_own)
        self._n_logs += 1
        values = []
        if self._n_logs in EARLY_PICTURES or self._n_logs % LOGS_PER_PICTURE == 0:
            values = self._pictures(n_decisions, Family.of(genealogy()))
            histogram = histogram_of(regions.progress.numpy())
            values.append(self._value("learning_progress/spread", histo=histogram))
        scalars |= self._by_region(*of_own)
        values += [self._value(tag, simple_value=value) for tag, value in scalars.items()]
        self._writer.add_summary(Summary(value=values), n_decisions)

    def _pictures(self, n_decisions: int, family: Family) -> list[Summary.Value]:
        """Choose anew which regions have curves, and return all pictures."""
        for region in self._followed.choose(family, self._visits):
            for tag, what in zip(_region_tags(self._followed.names[region]), CURVES, strict=True):
                self._undescribed[tag] = f"{what} {OF_REGION}"
        zones = self._visits.zones(len(family.parents))
        scene = Scene(n_decisions, family, zones, self._zone_names, self._followed.present)
        pictures = {
            "development/view_figure_2": self._regions.draw_lines(scene, ERRORS),
            "development/view_map": self._regions.draw_map(scene),
            "development/view_progress": self._regions.draw_lines(scene, PROGRESS),
        }
        if self._zone_names:
            pictures["development/view_figure_3"] = self._zones.draw(self._zone_names)
        if self._calibration.is_known:
            pictures["mp_calibration/deciles"] = self._calibration.draw()
        return [self._value(tag, image=picture) for tag, picture in pictures.items()]

    def _by_region(
        self,
        regions: NDArray[np.int64],
        progress: NDArray[np.float64],
        errors: NDArray[np.float64],
    ) -> dict[str, float]:
        """Return the progress and the mean error of the regions that have curves, `(L,)` each."""
        places = {region: place for place, region in enumerate(regions.tolist())}
        scalars: dict[str, float] = {}
        for region in self._followed.present:
            if region in places:  # it may have been cut since
                values = (float(of[places[region]]) for of in (progress, errors))
                tags = _region_tags(self._followed.names[region])
                scalars |= dict(zip(tags, values, strict=True))
        return {tag: value for tag, value in scalars.items() if np.isfinite(value)}

    def zone_of(self, region: int) -> str:
        """Return the zone in which a region of agent 0 lies; nothing if it lies in none."""
        zone = int(self._visits.zones(region + 1)[region])
        return "" if zone == NONE else self._zone_names[zone]

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
            "visits": self._visits.state(),
            "followed": self._followed.state(),
            "regions": self._regions.state(),
            "zones": self._zones.state(),
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
            self._visits.load_state(state["visits"])
            self._followed.load_state(state["followed"])
            self._regions.load_state(state["regions"])
            self._zones.load_state(state["zones"])
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


def _region_tags(name: str) -> tuple[str, ...]:
    """Return the tags of a region's curves, in the order of `CURVES`."""
    return f"learning_progress/{name}", f"prediction_error/{name}"


def _descriptions(zone_names: Sequence[str], shadows: Sequence[str]) -> dict[str, str]:
    """Return the descriptions of the tags of each zone and shadow."""
    texts = {
        f"prediction_error/{name}": f"Mean prediction error of the shadow {name}."
        for name in shadows
    }
    for name in zone_names:
        texts |= {
            f"development/time_in_{name}": f"Share of the last decisions in {name}, over all "
            "agents.",
            f"learning_progress/in_{name}": "Mean learning progress of the regions that predicted "
            f"the last decisions in {name}, over all agents.",
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
    by_zone = {
        "development/time_in_{}": zones.counts / whole.counts,
        "learning_progress/in_{}": zones.means("progress"),
        "mp_calibration/{}/expected": zones.means("expected_error"),
        "mp_calibration/{}/actual": zones.means("error"),
    }
    if not np.isfinite(means["prediction_error/expected"]):
        del by_zone["mp_calibration/{}/actual"]
    for tag, values in by_zone.items():
        pairs = zip(zone_names, values[0].tolist(), strict=False)
        means |= {tag.format(name): value for name, value in pairs}
    return {tag: mean for tag, mean in means.items() if np.isfinite(mean)}


def _over_agents(regions: RegionSummary, n_agents: int) -> dict[str, float]:
    """Return measures of the present regions, each the mean over all agents."""
    best = np.full(n_agents, -np.inf)
    np.maximum.at(best, regions.agent.numpy(), regions.progress.numpy())
    return {
        "learning_progress/best": float(best.mean()),
        "development/n_regions": len(regions.agent) / n_agents,
    }


def _layout(
    zone_names: Sequence[str], shadows: Sequence[str]
) -> dict[str, dict[str, tuple[str, list[str]]]]:
    """Return the charts of TensorBoard's page of custom scalars, by category.

    A chart has one tag, a regular expression, since TensorBoard gives all lines of a run the same
    colour.
    """
    charts = {
        "Share of time": {f"in {name}": f"development/time_in_{name}" for name in zone_names},
        "Learning progress": {
            "of the best region": "learning_progress/best",
            **{f"in {name}": f"learning_progress/in_{name}" for name in zone_names},
        },
        "Prediction error": {
            "of the experts": "prediction_error/mean",
            "expected by MP": "prediction_error/expected",
            **{f"of the shadow {name}": f"prediction_error/{name}" for name in shadows},
        },
        "Regions": {"how many": "development/n_regions"},
    }
    return {
        category: {title: ("Multiline", [f"{re.escape(tag)}$"]) for title, tag in of.items()}
        for category, of in charts.items()
        if of
    }
