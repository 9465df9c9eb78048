"""Pictures for TensorBoard: calibration and the map of progress.

Shapes: `A` agents, `T` decisions.
"""

import io
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from tensorboard.compat.proto.summary_pb2 import HistogramProto, Summary

from torch_iac.records import Genealogy
from torch_iac.regions.tree import NONE
from torch_iac.runs.statistics import by_decile

MAP_COLUMNS = 256
"""How many moments the map holds; when it is full, every other one is dropped."""

MAP_PIXELS = (384, 640)
"""Height and width of the map."""

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


class ProgressMap:
    """An agent's learning progress, region by region, over the whole run, in bounded memory."""

    def __init__(self) -> None:
        self._moments: list[tuple[NDArray[np.int64], NDArray[np.float64]]] = []
        self._stride = 1
        self._n_added = 0

    def add(self, regions: NDArray[np.int64], progress: NDArray[np.float64]) -> None:
        """Keep the progress of the regions that are there now, shape `(R,)`."""
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
    """Return the path from the root to each region: 0 for left, 1 for right, cut by cut."""
    paths = [""] * len(parents)
    has_left = set()
    for region, parent in enumerate(parents):
        if parent != NONE:
            paths[region] = paths[parent] + ("1" if parent in has_left else "0")
            has_left.add(parent)
    return paths


def _image(progress: NDArray[np.float64]) -> Summary.Image:
    """Return a picture of rows of progress: white is none, red positive, blue negative."""
    from matplotlib import colormaps  # slow to import

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
