"""Annotation panels of film frames: the robot's action, its region, prediction and time.

Frames have shape `(720, 1280, 3)`, with a place for a picture of the world.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from torch_iac.analysis.region_history import region_bounds
from torch_iac.analysis.style import MIXED_COLOUR, name_ends, time_axis, zone_colour, zone_style
from torch_iac.replay.scenes import Stage
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import WINDOW
from torch_iac.runs.statistics import zone_shares
from torch_iac.space import Dimension

Frame = NDArray[np.uint8]
"""A picture, shape `(height, width, 3)`: red, green and blue."""

WIDTH, HEIGHT = 1280, 720
"""Size of a frame (pixels)."""

ROOM = (640, 480)
"""Width and height of the world's pictures on it (pixels)."""

ROOM_AT = (24, 76)
"""Where they are, from the left and from the top (pixels)."""

COLUMN = 700
"""Where the column beside the room begins, from the left (pixels)."""

MOST_CUTS = 5
"""Sensors whose cuts the column names, at most."""

MOST_ACTIONS = 3
"""Dimensions of the action that have an axis, at most."""

LINE = 62
"""Characters in a line of small text, at most."""

UNBROKEN = "\N{NO-BREAK SPACE}"
"""A space at which lines are not broken."""

PREDICTED, OUTCOME = "#E69F00", "#000000"
"""Orange and black: markers."""

AMBER, GREY = "#946200", "#555555"
"""The orange of the markers, dark enough for text, and grey for secondary text."""

REGION: dict[str, Any] = {"color": "black", "linewidth": 5, "solid_capstyle": "butt"}
"""Style of the part of an axis that a region covers."""

TO_COME: dict[str, Any] = {"color": "white", "alpha": 0.75, "linewidth": 0, "zorder": 3}
"""Style of the decisions still to come."""

STYLE: dict[Any, Any] = {
    "font.size": 14,
    "xtick.labelsize": 12,
    "ytick.labelsize": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
"""Matplotlib's settings for all frames."""


@dataclass(frozen=True)
class Sheets:
    """Annotation panels about one robot of a run.

    Attributes:
        run: The run.
        agent: Which robot.
        world: The world's metadata; its sensors have `sensor_units`.
    """

    run: Run
    agent: int = 0
    world: Mapping[str, Any] = field(default_factory=dict)

    def card(self, stage: Stage) -> Frame:
        """Return the title of a stage, shape `(720, 1280, 3)`."""
        last = stage.first + stage.n_decisions - 1
        with mpl.rc_context(STYLE):
            figure = _blank()
            middle: dict[str, Any] = {"ha": "center", "va": "center"}
            figure.text(0.5, 0.62, stage.title, fontsize=36, fontweight="bold", **middle)
            text = f"decisions {stage.first:,} to {last:,} of {self.run.n_decisions:,}"
            figure.text(0.5, 0.5, text, fontsize=20, **middle)
            self._draw_time(figure, stage.first)
            return _drawn(figure)

    def sheet(self, row: Mapping[str, Any], stage: Stage) -> Frame:
        """Return the annotation panel of a film frame, with a place for the room.

        Args:
            row: What was recorded of it, by column.
            stage: What it belongs to.

        Returns:
            Shape `(720, 1280, 3)`.
        """
        with mpl.rc_context(STYLE):
            figure = _blank()
            _write(figure, ROOM_AT[0], 20, stage.title, fontsize=24, fontweight="bold")
            of_all = f"decision {row['step']:,} of {self.run.n_decisions:,}"
            _write(figure, COLUMN, 24, of_all, fontsize=18)
            self._draw_action(figure, row)
            self._write_region(figure, row)
            self._draw_outcome(figure, row)
            self._draw_time(figure, row["step"])
            return _drawn(figure)

    @cached_property
    def _units(self) -> dict[str, str]:
        names = [dimension.name for dimension in self.run.space.sensors]
        units = self.world.get("sensor_units", [""] * len(names))
        return dict(zip(names, units, strict=True))

    @cached_property
    def _lately(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The actions, shape `(T, actions)`, and the zones, `(T,)`, of all decisions."""
        names = [f"action/{dimension.name}" for dimension in self.run.space.actions]
        zones = ["zone"] if self.run.zone_names else []
        table = self.run.table([*names, *zones], self.agent)
        actions = np.stack([table[name].to_numpy() for name in names], axis=1)
        none = np.full(len(actions), -1)
        return actions, table["zone"].to_numpy().astype(np.int64) if zones else none

    @cached_property
    def _shares(self) -> NDArray[np.float64]:
        """The robot's share of time in each zone, window after window, shape `(W, Z)`."""
        return zone_shares(self.run)[:, self.agent] if self.run.zone_names else np.empty((0, 0))

    def _draw_action(self, figure: Figure, row: Mapping[str, Any]) -> None:
        """Show the action, those before it, and the part of its axes that the region covers."""
        why = "random action" if row["random_action"] else "action chosen by the drive"
        zone = row.get("zone")
        if zone is not None:
            name = self.run.zone_names[zone]
            _write(figure, COLUMN, 72, name, fontsize=22, fontweight="bold", color=_colour(zone))
        _write(figure, COLUMN + (50 if zone is not None else 0), 78, why, fontsize=15)
        bounds = region_bounds(self.run, row["region"], self.agent)
        for place, dimension in enumerate(self.run.space.actions[:MOST_ACTIONS]):
            axes = _axis(figure, 118 + 44 * place, dimension)
            self._draw_lately(axes, row["step"], place)
            axes.plot(bounds.get(dimension.name, axes.get_xlim()), (0.12, 0.12), **REGION)
            value = row[f"action/{dimension.name}"]
            axes.plot(value, 0.72, "v", color=_colour(zone), markersize=12, clip_on=False)
            _label(axes, dimension.name, self._said(dimension.name, value))
        key = f"triangles: this action; ticks: the last {WINDOW}; bars: the region"
        _write(figure, COLUMN, 252, key, fontsize=12, color=GREY)

    def _draw_lately(self, axes: Axes, decision: int, place: int) -> None:
        """Show one dimension of the last actions, in the colours of their zones."""
        lately = slice(max(0, decision - WINDOW), decision)
        actions, zones = (of[lately] for of in self._lately)
        colours = [_colour(zone) for zone in zones]
        axes.vlines(actions[:, place], 0.3, 0.55, colors=colours, linewidth=0.8, alpha=0.5)

    def _write_region(self, figure: Figure, row: Mapping[str, Any]) -> None:
        """Write which region predicts, its bounds and its progress."""
        region = row["region"]
        depth = self.run.family(self.agent)["depth"][region].as_py()
        cuts = f"{depth} cut{'s' if depth != 1 else ''} from the root" if depth else "the root"
        _write(figure, COLUMN, 284, f"Region {region}, {cuts}", fontsize=16, fontweight="bold")
        progress = round(row["progress"], 4) + 0.0  # no minus before 0
        text = f"learning progress {progress:+.4f} (scaled)"
        _write(figure, COLUMN, 310, text, fontsize=16)
        where = fill(self._place(region), LINE)
        _write(figure, COLUMN, 338, where, fontsize=12.5, linespacing=1.35)

    def _place(self, region: int) -> str:
        """Return in words where the cuts along sensors have left a region."""
        bounds = region_bounds(self.run, region, self.agent)
        sensors = {d.name: d for d in self.run.space.sensors if d.name in bounds}
        said = [self._between(d, *bounds[name]) for name, d in sensors.items()]
        said = [words.replace(" ", UNBROKEN) for words in said]
        if not said:
            return "whatever is sensed"
        more = len(said) - MOST_CUTS
        said[MOST_CUTS:] = [f"and {more} more"] if more > 0 else []
        return "where " + ", ".join(said)

    def _between(self, dimension: Dimension, low: float, high: float) -> str:
        name = dimension.name
        if low == dimension.low:
            return f"{name} up to {self._said(name, high)}"
        if high == dimension.high:
            return f"{name} above {self._said(name, low)}"
        return f"{name} {low:.2f} to {self._said(name, high)}"

    def _draw_outcome(self, figure: Figure, row: Mapping[str, Any]) -> None:
        """Show the prediction and the outcome, of the first outcome's dimension."""
        dimension = self.run.space.outcomes[0]
        name = dimension.name
        predicted, outcome = row[f"prediction/{name}"], row[f"outcome/{name}"]
        _write(figure, COLUMN, 408, f"Next {name}", fontsize=16, fontweight="bold")
        _write(figure, COLUMN, 434, f"predicted {self._said(name, predicted)}", color=AMBER)
        _write(figure, COLUMN + 320, 434, f"outcome {self._said(name, outcome)}")
        of_all = ", of all outcomes" if len(self.run.space.outcomes) > 1 else ""
        _write(figure, COLUMN + 320, 410, f"error {row['error']:.4f} (scaled{of_all})")
        axes = _axis(figure, 466, dimension, left=COLUMN + 12, width=520)
        axes.plot((predicted, outcome), (0.4, 0.4), color=MIXED_COLOUR, linewidth=4)
        axes.plot(predicted, 0.4, "D", color=PREDICTED, markersize=12, clip_on=False)
        axes.plot(outcome, 0.4, "o", color=OUTCOME, markersize=8, clip_on=False)
        axes.tick_params(labelbottom=True, length=4)
        unit = self._units[name]
        axes.set_xlabel(f"{name} ({unit})" if unit else name, fontsize=12, labelpad=1)

    def _draw_time(self, figure: Figure, decision: int) -> None:
        """Show the shares of time in each zone: figure 3, with a cursor."""
        axes = _place(figure, 90, 606, 1110, 66)
        time_axis(axes, self.run.n_decisions, n_ticks=8)
        axes.set_xlabel("Decisions", fontsize=12, labelpad=1)
        axes.axvline(decision, color="black", linewidth=2, zorder=4)
        axes.set_ylim(0, 1)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.axvspan(decision, self.run.n_decisions, **TO_COME)
        middles = (np.arange(len(self._shares)) + 0.5) * WINDOW
        for zone in range(len(self.run.zone_names)):
            axes.plot(middles, self._shares[:, zone], linewidth=2, **zone_style(zone))
        if len(self._shares):
            ends = dict(zip(self.run.zone_names, self._shares[-1].tolist(), strict=True))
            name_ends(axes, ends, [zone_colour(zone) for zone in range(len(ends))], size=15)
            _write(figure, 90, 574, f"Share of time in {WINDOW} decisions", fontsize=12.5)

    def _said(self, name: str, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.2f} {self._units.get(name, '')}".rstrip()


def _blank() -> Figure:
    return Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)


def _drawn(figure: Figure) -> Frame:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())[:, :, :3]  # type: ignore[no-untyped-call]


def _write(figure: Figure, left: float, top: float, text: str, **style: Any) -> None:
    """Write text whose upper left corner is there (pixels)."""
    figure.text(left / WIDTH, 1 - top / HEIGHT, text, va="top", **style)


def _place(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Return axes that are there (pixels)."""
    bottom = HEIGHT - top - height
    return figure.add_axes((left / WIDTH, bottom / HEIGHT, width / WIDTH, height / HEIGHT))


def _axis(
    figure: Figure, top: float, dimension: Dimension, left: float = COLUMN + 128, width: float = 352
) -> Axes:
    """Return a single axis, as long as the dimension's bounds."""
    axes = _place(figure, left, top, width, 32)
    axes.set(xlim=(dimension.low, dimension.high), ylim=(0, 1), yticks=[])
    axes.spines["left"].set_visible(False)
    axes.tick_params(labelbottom=False, length=0)
    return axes


def _label(axes: Axes, name: str, value: str) -> None:
    """Write a name before an axis and a value after it."""
    beside: dict[str, Any] = {"transform": axes.transAxes, "va": "center", "fontsize": 14}
    axes.text(-0.03, 0.3, name, ha="right", **beside)
    axes.text(1.03, 0.3, value, ha="left", **beside)


def _colour(zone: int | None) -> str:
    return zone_colour(-1 if zone is None else zone)
