"""Reads a run folder back: its config, decisions and regions, and how they went over time.

Shapes: `T` decisions, `A` agents, `Z` zones, `W` windows of decisions, `R` regions of an agent, `P`
points of a curve.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from torch_iac.files import parse_json
from torch_iac.space import SensorimotorSpace
from torch_iac.tallies import Tally, tally_columns

CONFIG = "config.json"
STEPS = "steps"
WINDOWS = "windows"
REGIONS = "regions.parquet"
SUMMARY = "summary.json"
CHECKPOINTS = "checkpoints"
EVENTS = "events.out.tfevents.*"
"""What the files and folders in a run folder are called; the last are TensorBoard's."""

MAIN = "main"
"""What the experts that the robot acts on are called beside their shadows."""

N_DECILES = 10
"""Into how many parts expectations are sorted."""

WINDOW = 250
"""How many decisions a window of time holds, if nobody says otherwise; and the windows in which
runs keep what all their agents did."""

ERROR_WINDOW, DELAY = 150, 150
"""Over how many errors a mean error is taken, and how many lie between the two means that make
learning progress, in a run whose config does not say."""


def load_run(folder: Path | str) -> "Run":
    """Open a run folder, of a run that has ended or still goes on.

    Raises:
        FileNotFoundError: The folder holds no run.
    """
    folder = Path(folder)
    if not (folder / CONFIG).is_file():
        raise FileNotFoundError(f"{folder} holds no run: there is no {CONFIG} in it")
    return Run(folder)


def part_path(folder: Path, number: int, kind: str = STEPS) -> Path:
    """Return where a run folder keeps a part of its `STEPS` or `WINDOWS`; parts count from 0."""
    return folder / kind / f"part-{number:05d}.parquet"


def shadow_error(name: str) -> str:
    """Return the column that holds the errors of a shadow."""
    return f"shadow/{name}/error"


def tallied_fields(shadows: Sequence[str]) -> list[str]:
    """Return the columns of the steps that windows sum up, those of the shadows last."""
    return ["error", "expected_error", "progress", *map(shadow_error, shadows)]


@dataclass(frozen=True)
class Run:
    """A run folder; each file is read when it is first asked for.

    Attributes:
        folder: Where it is.
    """

    folder: Path

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything needed to run it again, as `config.json` has it.

        Raises:
            ValueError: The file is not the config of a run.
        """
        path = self.folder / CONFIG
        config = _read_json(path)
        missing = [key for key in ("space", "seeds", "zones") if key not in config]
        if missing:
            raise ValueError(f"{path} must be the config of a run, but it has no {missing[0]}")
        return config

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The run's measures, as `summary.json` has them; `measures.summarise` says what they are.

        Raises:
            FileNotFoundError: The run has not ended.
        """
        if not (self.folder / SUMMARY).is_file():
            raise FileNotFoundError(f"{self.folder} has no {SUMMARY} yet: the run has not ended")
        return _read_json(self.folder / SUMMARY)

    @cached_property
    def space(self) -> SensorimotorSpace:
        """The names and bounds of the actions, sensors and outcomes."""
        return SensorimotorSpace.from_json(self.config["space"])

    @property
    def situation_columns(self) -> tuple[str, ...]:
        """The columns of the steps that make a situation, in the order of `space.situation`."""
        actions = (f"action/{dimension.name}" for dimension in self.space.actions)
        sensors = (f"sensor/{dimension.name}" for dimension in self.space.sensors)
        return (*actions, *sensors)

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each agent."""
        return tuple(self.config["seeds"])

    @property
    def n_agents(self) -> int:
        """How many agents there are."""
        return len(self.seeds)

    @property
    def n_recorded(self) -> int:
        """Of how many agents, the first, the steps are recorded."""
        return int(self.config.get("recorded_agents", self.n_agents))

    @property
    def zone_names(self) -> tuple[str, ...]:
        """The names of the world's zones; none if it has no zones."""
        return tuple(self.config["zones"] or ())

    @property
    def shadow_names(self) -> tuple[str, ...]:
        """The names of the experts that only looked on."""
        return tuple(self.config.get("shadows", ()))

    @property
    def error_columns(self) -> dict[str, str]:
        """The column with the errors of each kind of experts: `MAIN`, then the shadows."""
        return {MAIN: "error"} | {name: shadow_error(name) for name in self.shadow_names}

    @cached_property
    def has_expectations(self) -> bool:
        """Whether the agents had an MP."""
        return bool(np.isfinite(self.column("expected_error")).any())

    @property
    def error_window(self) -> int:
        """Over how many errors its agents take a mean error: their config's `window`."""
        return int(self.config.get("iac", {}).get("window", ERROR_WINDOW))

    @property
    def delay(self) -> int:
        """How many errors lie between the means that its agents compare: their config's `delay`."""
        return int(self.config.get("iac", {}).get("delay", DELAY))

    @property
    def inherits_history(self) -> bool:
        """Whether the children of a region take over its errors."""
        return bool(self.config.get("iac", {}).get("inherit_history", True))

    @property
    def n_decisions(self) -> int:
        """How many decisions each agent has taken so far."""
        n_rows: int = sum(_open_part(path).metadata.num_rows for path in self.parts())
        return n_rows // self.n_recorded

    @cached_property
    def steps(self) -> pa.Table:
        """Every column of every recorded decision: `run.steps["error"].to_numpy()`.

        Rows are by step, then agent; of the first `n_recorded` agents.

        For a big run, ask for what you need: `table` and `column`.

        Raises:
            FileNotFoundError: There are no decisions yet, or a part is missing.
            ValueError: A part cannot be read.
        """
        return self.table()

    @cached_property
    def regions(self) -> pa.Table:
        """Every region ever made, by agent, then region; cuts in raw units.

        Raises:
            ValueError: The file is not there or cannot be read.
        """
        return _read_part(self.folder / REGIONS)

    @cached_property
    def windows(self) -> Tally:
        """What every agent did, recorded or not, in each `WINDOW` decisions; shape `(W, A, Z)`.

        The last window has fewer decisions if the run does not end with it.

        Raises:
            FileNotFoundError: There are no windows yet, or a part is missing.
            ValueError: A part cannot be read.
        """
        parts = [_read_part(path) for path in self.parts(WINDOWS)]
        firsts = np.concatenate([_first_decisions(part) for part in parts])
        numbers = (firsts - firsts[0]) // WINDOW

        def by_window(names: Sequence[str]) -> NDArray[Any]:
            rows = [np.stack([part[name].to_numpy() for name in names], axis=-1) for part in parts]
            blocks = np.concatenate(rows).reshape(len(numbers), self.n_agents, len(names))
            # A window that two parts share has rows in both.
            total = np.zeros((numbers.max() + 1, *blocks.shape[1:]), blocks.dtype)
            np.add.at(total, numbers, blocks)
            return total

        fields = tallied_fields(self.shadow_names)
        counts, *sums = map(by_window, tally_columns(fields, self.zone_names))
        return Tally(counts, dict(zip(fields, sums, strict=True)))

    def parts(self, kind: str = STEPS) -> list[Path]:
        """Return the files that hold the decisions, or the `WINDOWS`, in order.

        Raises:
            FileNotFoundError: There are none yet, or one is missing.
        """
        found = sorted((self.folder / kind).glob("part-*.parquet"))
        if not found:
            raise FileNotFoundError(f"{self.folder} holds no decisions yet")
        expected = [part_path(self.folder, number, kind) for number in range(len(found))]
        missing = [path for path in expected if path not in found]
        if missing:
            raise FileNotFoundError(f"{missing[0]} is missing, though later parts are there")
        return expected

    def table(self, columns: Sequence[str] | None = None, agent: int | None = None) -> pa.Table:
        """Return some columns of the steps, by step, then agent.

        Args:
            columns: Their names; all if none are given.
            agent: The only agent to return; all that are recorded if none is given.

        Raises:
            ValueError: There is no such agent or column, the agent's steps are not recorded, or a
                part cannot be read (it is named).
        """
        if agent is None:
            return pa.concat_tables([_read_part(path, columns) for path in self.parts()])
        self.check_recorded(agent)
        return pa.concat_tables(
            part.take(np.arange(agent, part.num_rows, self.n_recorded))
            for part in (_read_part(path, columns) for path in self.parts())
        )

    def column(self, name: str) -> NDArray[Any]:
        """Return one column of the recorded agents, the first, shape `(T, A)`; nulls are NaN.

        Raises:
            ValueError: There is no such column, or a part cannot be read.
        """
        values: NDArray[Any] = self.table([name])[name].to_numpy()
        return values.reshape(-1, self.n_recorded)

    def family(self, agent: int = 0) -> pa.Table:
        """Return the regions of one agent; row `i` is region `i`.

        Raises:
            ValueError: There is no such agent.
        """
        self._check_agent(agent)
        start, end = np.searchsorted(self._owners, [agent, agent + 1])
        return self.regions.slice(start, end - start)

    @cached_property
    def _owners(self) -> NDArray[np.int32]:
        """The agent of each of `regions`, in order."""
        return np.asarray(self.regions["agent"])

    def check_recorded(self, agent: int) -> None:
        """Refuse an agent that is not there or whose steps are not recorded.

        Raises:
            ValueError: It is so.
        """
        self._check_agent(agent)
        if agent >= self.n_recorded:
            raise ValueError(
                f"agent must be one of the first {self.n_recorded} of {self.n_agents}, whose steps "
                f"are recorded, got {agent}"
            )

    def _check_agent(self, agent: int) -> None:
        if not 0 <= agent < self.n_agents:
            raise ValueError(f"agent must lie in [0, {self.n_agents}), got {agent}")


@dataclass(frozen=True)
class ErrorCurve:
    """How the mean error of a region went, from its birth to its split or the end of the run.

    Attributes:
        region: Which region.
        decisions: Shape `(P,)`: when; the birth, each decision it predicted, the end.
        mean_errors: Shape `(P,)`: the mean of its last errors then, in scaled units.
    """

    region: int
    decisions: NDArray[np.int64]
    mean_errors: NDArray[np.float64]


def error_curves(run: Run, agent: int = 0, window: int | None = None) -> list[ErrorCurve]:
    """Return the mean error over time of every region that has one, in order of birth.

    A child inherits its parent's errors, so its curve starts where its parent's ends; in a run
    whose config says that nothing is inherited, it starts with the child's own first error.

    Args:
        run: The run.
        agent: Whose regions.
        window: How many of the region's last errors the mean is over, fewer while it has fewer;
            the run's own `error_window` if none is given.

    Raises:
        ValueError: There is no such agent, or its steps are not recorded.

    Source: Oudeyer and Kaplan (2004), figure 2.
    """
    window = run.error_window if window is None else window
    steps = run.table(["error", "region"], agent)
    errors = steps["error"].to_numpy()
    own_decisions = _decisions_by_region(steps["region"].to_numpy())
    nothing = np.empty(0, dtype=np.int64)
    no_errors = np.empty(0)
    last_errors: dict[int, NDArray[np.float64]] = {-1: no_errors}
    curves = []
    for row in run.family(agent).to_pylist():
        region, inherited = row["region"], last_errors[row["parent"]]
        own = own_decisions.get(region, nothing)
        history = np.concatenate([inherited, errors[own]])
        last_errors[region] = history[-window:] if run.inherits_history else no_errors
        if not len(history):
            continue
        means = _running_mean(history, window)[max(len(inherited) - 1, 0) :]
        birth = [row["born_step"]] if len(inherited) else []
        end = len(errors) - 1 if row["split_step"] < 0 else row["split_step"]
        curves.append(
            ErrorCurve(
                region,
                np.array([*birth, *own.tolist(), end], dtype=np.int64),
                np.append(means, means[-1]),
            )
        )
    return curves


def ancestors(run: Run, region: int, agent: int = 0) -> tuple[int, ...]:
    """Return a region's parent, its parent's parent and so on to the root.

    Raises:
        ValueError: There is no such agent.
        IndexError: It has no such region.
    """
    parents = run.family(agent)["parent"].to_numpy()
    line = []
    while (region := int(parents[region])) >= 0:
        line.append(region)
    return tuple(line)


def children_of(family: Sequence[Mapping[str, Any]]) -> dict[int, list[int]]:
    """Return the children of each region of an agent: the one below its cut, the one above.

    Args:
        family: The rows of `Run.family`; the root is the only child of -1.
    """
    children: dict[int, list[int]] = {}
    for row in family:  # the child below the cut comes first
        children.setdefault(row["parent"], []).append(row["region"])
    return children


def region_bounds(run: Run, region: int, agent: int = 0) -> dict[str, tuple[float, float]]:
    """Return where a region lies: its bounds, in raw units, in each dimension that was cut for it.

    Dimensions are in the order of the first cut along each, from the root on.

    Raises:
        ValueError: There is no such agent.
        IndexError: It has no such region.
    """
    family = run.family(agent).to_pylist()
    children = children_of(family)
    whole = {dimension.name: (dimension.low, dimension.high) for dimension in run.space.situation}
    bounds: dict[str, tuple[float, float]] = {}
    line = [region, *ancestors(run, region, agent)]
    for parent, child in reversed(list(zip(line[1:], line, strict=False))):
        name, value = family[parent]["cut_dimension"], family[parent]["cut_value"]
        low, high = bounds.get(name, whole[name])
        bounds[name] = (low, value) if child == children[parent][0] else (value, high)
    return bounds


@dataclass(frozen=True)
class RegionZones:
    """Which zone of the world each region of an agent covers, by the decisions it predicted.

    Attributes:
        zone: Shape `(R,)`: the zone most of them were in; -1 for a region without any.
        purity: Shape `(R,)`: their share in that zone; NaN for a region without any.
    """

    zone: NDArray[np.int64]
    purity: NDArray[np.float64]


def region_zones(run: Run, agent: int = 0) -> RegionZones:
    """Return the zone that each region of an agent mostly covers, in a world with zones.

    Raises:
        ValueError: There is no such agent, its steps are not recorded, or there are no zones.
    """
    steps = run.table(["region", "zone"], agent)
    counts = np.zeros((run.family(agent).num_rows, len(run.zone_names)))
    np.add.at(counts, (steps["region"].to_numpy(), steps["zone"].to_numpy()), 1)
    total = counts.sum(axis=1)
    share = np.divide(counts.max(axis=1), total, out=np.full(len(total), np.nan), where=total > 0)
    return RegionZones(np.where(total > 0, counts.argmax(axis=1), -1), share)


def final_leaves(run: Run) -> NDArray[np.int64]:
    """Return the leaf in which each situation lies when the run ends, shape `(T, A)`.

    That is the recorded `region`, or one that came of it by later splits; of recorded agents.
    """
    situations = {
        name: run.column(column)
        for name, column in zip(run.space.situation_names, run.situation_columns, strict=True)
    }
    leaves = np.zeros((run.n_decisions, run.n_recorded), np.int64)
    for agent in range(run.n_recorded):
        mine = {name: values[:, agent] for name, values in situations.items()}
        _route(leaves[:, agent], run.family(agent).to_pylist(), mine)
    return leaves


def _route(
    regions: NDArray[np.int64],
    family: Sequence[Mapping[str, Any]],
    situations: Mapping[str, NDArray[np.float32]],
) -> None:
    """Move situations from the root to their leaves, in place; parents come before children."""
    children = children_of(family)
    for row in family:
        if row["split_step"] >= 0:
            here = np.flatnonzero(regions == row["region"])
            above = situations[row["cut_dimension"]][here] > row["cut_value"]
            left, right = children[row["region"]]
            regions[here] = np.where(above, right, left)


def zone_shares(run: Run, window: int = WINDOW) -> NDArray[np.float64]:
    """Return the share of its time that each agent spends in each zone, window after window.

    Args:
        run: The run.
        window: Decisions a window; a last window that is not full is left out. Any number if the
            steps of all agents are recorded, else a multiple of `WINDOW`.

    Returns:
        Shape `(W, A, Z)`.

    Raises:
        ValueError: The world has no zones, or the window is none that was kept.

    Source: Oudeyer and Kaplan (2004), figure 3.
    """
    if not run.zone_names:
        raise ValueError(f"the world of {run.folder} has no zones, so it has no shares of them")
    return np.asarray(tally(run, "error", window).counts / window)


def zone_errors(run: Run, column: str = "error", window: int = WINDOW) -> NDArray[np.float64]:
    """Return the mean error of each agent in each zone, window after window.

    Args:
        run: The run.
        column: Whose errors, by their column; `run.error_columns` has them.
        window: Decisions a window, as `zone_shares` has it.

    Returns:
        Shape `(W, A, Z)`, in scaled units; NaN where an agent was not there. Without zones, one
        stands for all.

    Raises:
        ValueError: The window is none that was kept.
    """
    return tally(run, column, window).means(column)


def tally(run: Run, column: str, window: int = WINDOW) -> Tally:
    """Return what every agent did in each full window of decisions, shape `(W, A, Z)`.

    Args:
        run: The run.
        column: What is summed up.
        window: Decisions a window, as `zone_shares` has it.

    Raises:
        ValueError: The window is none that was kept.
    """
    n_windows = run.n_decisions // window
    if window % WINDOW == 0 or window == run.n_decisions < WINDOW:
        n_kept = -(-window // WINDOW)  # windows that were kept in one that is asked for

        def joined(values: NDArray[Any]) -> NDArray[Any]:
            shape = (n_windows, n_kept, *values.shape[1:])
            return np.asarray(values[: n_windows * n_kept].reshape(shape).sum(axis=1))

        return Tally(joined(run.windows.counts), {column: joined(run.windows.sums[column])})
    if run.n_recorded < run.n_agents:
        raise ValueError(
            f"window must be a multiple of {WINDOW} where the steps of {run.n_recorded} of "
            f"{run.n_agents} agents are recorded, got {window}"
        )
    values = run.column(column)
    zones = run.column("zone") if run.zone_names else np.zeros(values.shape, np.int8)
    shape = (n_windows, window, run.n_agents)
    values, zones = (of[: n_windows * window].reshape(shape) for of in (values, zones))
    here = [zones == zone for zone in range(max(1, len(run.zone_names)))]
    counts = np.stack([of.sum(axis=1) for of in here], axis=-1)
    sums = np.stack([np.sum(values, axis=1, where=of, dtype=np.float64) for of in here], axis=-1)
    return Tally(counts, {column: sums})


def by_decile(
    expected: NDArray[Any], actual: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what came of each tenth of the expectations, from the lowest to the highest.

    Args:
        expected: Shape `(T, A)`.
        actual: Shape `(T, A)`, what came.

    Returns:
        The mean expectation of each tenth of each agent's decisions and the mean of what came,
        each of shape `(10,)`, means over agents; NaN for tenths of nothing.
    """
    order = np.argsort(expected, axis=0, kind="stable")

    def tenths(values: NDArray[Any]) -> NDArray[np.float64]:
        parts = np.array_split(np.take_along_axis(values, order, axis=0), N_DECILES)
        return np.array([known_mean(known_mean(part, axis=0)) for part in parts])

    return tenths(expected), tenths(actual)


def known_mean(
    values: NDArray[Any], axis: int | None = None, where: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the mean of what is not NaN (and where asked); NaN, not a warning, for nothing.

    Args:
        values: Any shape.
        axis: Along which the mean is taken, and which goes; along all if none is given.
        where: The shape of `values`, which of them count; all if not given.
    """
    counted = np.isfinite(values) if where is None else where & np.isfinite(values)
    n_counted = counted.sum(axis=axis)
    total = np.sum(values, axis=axis, where=counted, dtype=np.float64)
    nothing = np.full(np.shape(total), np.nan)
    return np.asarray(np.divide(total, n_counted, out=nothing, where=n_counted > 0))


def focus_steps(run: Run, zone: str, share: float, window: int = WINDOW) -> list[int | None]:
    """Return when each agent first focuses on a zone: spends more than `share` of a window in it.

    Returns:
        The first decision of that window, agent by agent; None for an agent that never does.

    Raises:
        ValueError: The world has no such zone, or the window is none that was kept.
    """
    focused = zone_shares(run, window)[:, :, run.zone_names.index(zone)] > share
    return [int(mine.argmax()) * window if mine.any() else None for mine in focused.T]


def _first_decisions(windows: pa.Table) -> NDArray[np.int64]:
    """Return the first decision of each window in a part, whose rows are by window, then agent."""
    steps: NDArray[np.int64] = windows.filter(pc.field("agent") == 0)["step"].to_numpy()
    return steps


def _decisions_by_region(regions: NDArray[np.int32]) -> dict[int, NDArray[np.int64]]:
    """Return, for each region that ever predicted, the decisions in which it did."""
    order = np.argsort(regions, kind="stable")
    names, starts = np.unique(regions[order], return_index=True)
    return dict(zip(names.tolist(), np.split(order, starts[1:]), strict=True))


def _running_mean(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Return the mean of the last `window` values at each place, of fewer near the start."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - window, 0)
    return np.asarray((total[end] - total[start]) / (end - start))


def _open_part(path: Path) -> pq.ParquetFile:
    try:
        return pq.ParquetFile(path)
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


def _read_part(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    part = _open_part(path)
    unknown = set(columns or ()) - set(part.schema_arrow.names)
    if unknown:
        raise ValueError(f"{path} has no column {sorted(unknown)[0]}")
    try:
        return part.read(columns)
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = parse_json(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} must hold names and values, got {str(content)[:80]}")
    return content
