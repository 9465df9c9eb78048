"""Pictures for TensorBoard: regions, the paper's figures 2 and 3, calibration.

Shapes: `A` agents, `T` decisions, `Z` zones, `W` windows of decisions, `R` regions that the first
robot ever had, `L` those that it has now.
"""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont
from tensorboard.compat.proto.summary_pb2 import HistogramProto, Summary

from torch_iac.regions.tree import NONE
from torch_iac.runs.charts import MIXED_COLOUR, Axis, Chart, shades, zone_colour
from torch_iac.runs.followed_regions import Family
from torch_iac.runs.schema import WINDOW
from torch_iac.runs.statistics import by_decile

Values = NDArray[np.float32]
"""A number a region, shape `(L,)`."""

N_MOMENTS = 256
"""How many moments of a run are kept; of more, every other one is dropped."""

PROGRESS, ERRORS = 1, 2
"""What is kept of the regions of a moment, by its place there."""

N_LINES = 150
"""Curves of so many present regions are drawn, at most."""

MOST_WINDOWS = 64
"""The curves of zones have at most so many points."""

STRONGEST, LEAST_PROGRESS = 0.98, 1e-9
"""The strongest colour begins at this quantile of the progress that a map shows; where there is no
progress, at the second number."""

STRIP = (1.0, 1.012)
"""Where the colours of zones are beside the map, as shares of its width."""

BOLD, THIN = 2.5, 0.5
"""Widths of curves (pixels); thin ones are drawn ten times as fast as any other."""

DECISIONS = "decisions"
"""The label of time."""

N_CALIBRATED = 1000
"""Decisions of an agent, the last ones, in the picture of MP's calibration."""

N_AGENTS_CALIBRATED = 64
"""Agents in it, the first ones."""

CALIBRATION_PIXELS = 320
"""Its height and its width."""

LEAST_ERROR = 1e-6
"""It shows smaller errors at its lower end, since it has logarithmic axes."""


class CalibrationChart:
    """MP's expected errors of the last decisions of the first agents, and the actual ones."""

    def __init__(self) -> None:
        self._expected, self._actual = np.empty((0, 0)), np.empty((0, 0))

    @property
    def is_known(self) -> bool:
        """Whether there is anything to draw."""
        return bool(self._expected.size)

    def add(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Keep the errors of some decisions, shape `(T, A)` each, if there is an MP."""
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
        """Return the expected and the actual errors that are kept, shape `(T, A)` each."""
        return [self._expected, self._actual]

    def load_state(self, state: list[NDArray[Any]]) -> None:
        """Go on from what `state` returned, shape `(T, A)` each."""
        self._expected, self._actual = state

    def draw(self) -> Summary.Image:
        """Return a picture of the mean error by decile of the expectation."""
        return _decile_picture(np.stack(by_decile(self._expected, self._actual)))


class RegionHistory:
    """The first robot's regions, their progress and errors, over the whole run, in bounded memory.

    Every so many logs it keeps a *moment*: the regions that are there then.
    """

    def __init__(self) -> None:
        self._decisions: list[int] = []
        self._moments: list[tuple[NDArray[np.int32], Values, Values]] = []
        self._stride = 1
        self._n_added = 0

    def add(
        self,
        n_decisions: int,
        regions: NDArray[np.int64],
        progress: NDArray[np.float64],
        errors: NDArray[np.float64],
    ) -> None:
        """Keep the progress and the mean error of the regions that are there now, shape `(L,)`."""
        if self._n_added % self._stride == 0:
            self._decisions.append(n_decisions)
            floats = (progress.astype(np.float32), errors.astype(np.float32))
            self._moments.append((regions.astype(np.int32), *floats))
        self._n_added += 1
        if len(self._moments) == N_MOMENTS:
            self._moments, self._stride = self._moments[::2], self._stride * 2
            self._decisions = self._decisions[::2]

    def state(self) -> dict[str, Any]:
        """Return the moments that are kept, one after the other, and how they are chosen."""
        regions, progress, errors = ([moment[i] for moment in self._moments] for i in range(3))
        nothing = np.empty(0, np.float32)
        return {
            "decisions": np.array(self._decisions, np.int64),
            "lengths": np.array([len(of) for of in regions], np.int64),
            "regions": np.concatenate([np.empty(0, np.int32), *regions]),
            "progress": np.concatenate([nothing, *progress]),
            "errors": np.concatenate([nothing, *errors]),
            "stride": self._stride,
            "n_added": self._n_added,
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` returned."""
        ends = state["lengths"].cumsum()[:-1]
        columns = (np.split(state[name], ends) for name in ("regions", "progress", "errors"))
        self._decisions = state["decisions"].tolist()
        self._moments = list(zip(*columns, strict=True)) if self._decisions else []
        self._stride, self._n_added = state["stride"], state["n_added"]

    def draw_map(self, scene: "Scene") -> Summary.Image:
        """Return a map of progress: a row a present region, a column a moment.

        Before a region was born, its row shows its ancestors.
        """
        rows = _in_tree_order(scene.family)
        lines = self._lines_of_descent(scene.family.parents, PROGRESS)[rows]
        known = np.abs(lines[np.isfinite(lines)])
        strongest = float(np.quantile(known, STRONGEST)) or LEAST_PROGRESS
        at = np.linspace(0, scene.n_decisions, N_MOMENTS)
        moments = np.searchsorted(self._decisions, at).clip(max=len(self._decisions) - 1)
        label = f"{len(rows)} present regions, in tree order"
        time = Axis(0, scene.n_decisions, DECISIONS)
        chart = Chart(time, Axis(0, len(rows), label), has_grid=False)
        chart.paint(shades(lines[:, moments], strongest))
        colours = [zone_colour(zone) for zone in scene.zones[rows].tolist()]
        strip = np.array([ImageColor.getrgb(colour) for colour in colours], np.uint8)
        chart.paint(strip[:, None], *STRIP)
        ramp = shades(np.linspace(-1, 1, 64), 1.0)
        chart.scale(ramp, f"errors grow, {-strongest:.2g}", f"{strongest:.2g}, errors fall")
        heights = {region: (row + 0.5) / len(rows) for row, region in enumerate(rows)}
        _note_regions(chart, scene, heights)
        return as_png(chart.picture())

    def draw_lines(self, scene: "Scene", column: int) -> Summary.Image:
        """Return the `PROGRESS` or the `ERRORS` of regions over time, those with names in bold.

        A region's curve goes from its birth, where it leaves its parent's, to its end. Of many
        present regions, `N_LINES` are drawn with their ancestors.

        Source: Oudeyer and Kaplan (2004), figure 2, has the errors.
        """
        chosen = _some(_in_tree_order(scene.family), N_LINES)
        drawn = _with_ancestors([*chosen, *scene.named], scene.family.parents)
        lines = self._lines_of_descent(scene.family.parents, column)
        drawn = [region for region in drawn if np.isfinite(lines[region]).any()]
        low, high = _bounds(lines[drawn])
        up = Axis(low, high, "mean error (scaled)" if column == ERRORS else "progress (scaled)")
        chart = Chart(Axis(0, scene.n_decisions, DECISIONS), up)
        births = self._births(len(scene.family.parents))
        times = np.array(self._decisions, float)
        for region in sorted(drawn, key=scene.named.__contains__):
            own = slice(max(0, births[region] - 1), None)  # from its parent's last on
            colour = zone_colour(int(scene.zones[region]))
            width = BOLD if region in scene.named else THIN
            chart.line(times[own], lines[region, own], colour, width)
        last = {region: float(lines[region][np.isfinite(lines[region])][-1]) for region in drawn}
        heights = {region: float(up.place(np.array(of))) for region, of in last.items()}
        _note_regions(chart, scene, heights)
        return as_png(chart.picture())

    def _lines_of_descent(self, parents: list[int], column: int) -> NDArray[np.float64]:
        """Return each region's values at each moment, its ancestors' before it was born."""
        lines = np.full((len(parents), len(self._moments)), np.nan)
        for moment, of in enumerate(self._moments):
            lines[of[0], moment] = of[column]
        births = self._births(len(parents)).tolist()
        for region, parent in enumerate(parents):  # parents come before their children
            if parent != NONE:
                lines[region, : births[region]] = lines[parent, : births[region]]
        return lines

    def _births(self, n_regions: int) -> NDArray[np.int64]:
        """Return the first moment at which each region was there; their number if at none."""
        births = np.full(n_regions, len(self._moments))
        for moment in range(len(self._moments) - 1, -1, -1):
            births[self._moments[moment][0]] = moment
        return births


class ZoneHistory:
    """How many decisions all robots took in each zone over the whole run, in bounded memory."""

    def __init__(self) -> None:
        self._ends: list[int] = []
        self._counts: list[NDArray[np.int64]] = []
        self._stride = 1
        self._n_added = 0

    def add(self, n_decisions: int, counts: NDArray[np.int64]) -> None:
        """Count in the decisions since the last time, shape `(Z,)`."""
        if self._n_added % self._stride == 0:
            if len(self._counts) == N_MOMENTS:
                pairs = zip(self._counts[::2], self._counts[1::2], strict=True)
                self._ends, self._counts = self._ends[1::2], [a + b for a, b in pairs]
                self._stride *= 2
            self._ends.append(n_decisions)
            self._counts.append(counts)
        else:
            self._ends[-1], self._counts[-1] = n_decisions, self._counts[-1] + counts
        self._n_added += 1

    def shares(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the middles of windows of at least `WINDOW` decisions, and shares of each zone.

        Shapes `(W,)` and `(W, Z)`; a run shorter than that is one window.
        """
        ends = np.array([0, *self._ends], np.float64)
        totals = np.cumsum([np.zeros_like(self._counts[0]), *self._counts], axis=0)
        n_windows = min(MOST_WINDOWS, max(1, int(ends[-1]) // WINDOW), len(self._ends))
        edges = np.linspace(0, ends[-1], n_windows + 1)
        until = np.stack([np.interp(edges, ends, of) for of in totals.T], axis=-1)
        counts = np.diff(until, axis=0)
        return (edges[:-1] + edges[1:]) / 2, counts / counts.sum(axis=1, keepdims=True)

    def draw(self, zone_names: Sequence[str]) -> Summary.Image:
        """Return the share of each zone over time.

        Source: Oudeyer and Kaplan (2004), figure 3.
        """
        middles, shares = self.shares()
        chart = Chart(Axis(0, self._ends[-1], DECISIONS), Axis(0, 1, "share of time"))
        colours = [zone_colour(zone) for zone in range(len(zone_names))]
        for of_zone, colour in zip(shares.T, colours, strict=True):
            chart.line(middles, of_zone, colour, BOLD)
        chart.key(dict(zip(zone_names, colours, strict=True)))
        chart.notes(list(zone_names), shares[-1].tolist(), colours)
        return as_png(chart.picture())

    def state(self) -> dict[str, Any]:
        """Return the counts that are kept, and how they are joined."""
        counts = np.stack(self._counts) if self._counts else np.empty((0, 0), np.int64)
        ends = np.array(self._ends, np.int64)
        return {"ends": ends, "counts": counts, "stride": self._stride, "n_added": self._n_added}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` returned."""
        self._ends, self._counts = state["ends"].tolist(), list(state["counts"])
        self._stride, self._n_added = state["stride"], state["n_added"]


@dataclass(frozen=True)
class Scene:
    """What pictures of regions need to know besides their history.

    Attributes:
        n_decisions: How many decisions each agent has taken.
        family: The first robot's regions.
        zones: Shape `(R,)`: the zone in which each lies; negative for none.
        zone_names: The names of the world's zones.
        named: The regions whose numbers are written.
    """

    n_decisions: int
    family: Family
    zones: NDArray[np.int64]
    zone_names: Sequence[str]
    named: Sequence[int]


def _note_regions(chart: Chart, scene: Scene, heights: Mapping[int, float]) -> None:
    """Write the numbers of regions beside a chart, and what the colours of zones are."""
    named = [region for region in scene.named if region in heights]
    colours = [zone_colour(int(scene.zones[region])) for region in named]
    chart.notes([f"region {n}" for n in named], [heights[n] for n in named], colours)
    key = {name: zone_colour(zone) for zone, name in enumerate(scene.zone_names)}
    chart.key({**key, "mixed": MIXED_COLOUR} if key else {})


def _in_tree_order(family: Family) -> list[int]:
    """Return the present regions, neighbours in the tree side by side."""
    return sorted(family.leaves.tolist(), key=_paths(family.parents).__getitem__)


def _with_ancestors(regions: Sequence[int], parents: Sequence[int]) -> list[int]:
    """Return some regions and all those that they came from, once each."""
    found: set[int] = set()
    for region in regions:
        while region != NONE and region not in found:
            found.add(region)
            region = parents[region]
    return sorted(found)


def _some(regions: list[int], n_regions: int) -> list[int]:
    """Return evenly spaced regions, at most so many."""
    return regions[:: -(-len(regions) // n_regions)]


def _bounds(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the ends of an axis for values, with 0 on it."""
    known = values[np.isfinite(values)]
    low, high = min(0.0, float(known.min(initial=0))), max(0.0, float(known.max(initial=0)))
    return low, high if high > low else low + LEAST_PROGRESS


def _paths(parents: Sequence[int]) -> list[str]:
    """Return the path from the root to each region: 0 for left, 1 for right, cut by cut."""
    paths = [""] * len(parents)
    has_left = set()
    for region, parent in enumerate(parents):
        if parent != NONE:
            paths[region] = paths[parent] + ("1" if parent in has_left else "0")
            has_left.add(parent)
    return paths


def as_png(picture: Image.Image) -> Summary.Image:
    """Return a picture as TensorBoard has it."""
    png = io.BytesIO()
    picture.save(png, format="png", compress_level=1)
    return Summary.Image(
        height=picture.height,
        width=picture.width,
        colorspace=3,
        encoded_image_string=png.getvalue(),
    )


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
    return as_png(picture)


def histogram_of(values: NDArray[np.float64]) -> HistogramProto:
    """Return some values, shape `(n,)`, as TensorBoard's histogram."""
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
