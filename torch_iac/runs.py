"""Reads a run folder back: its config, decisions and regions, and what can be measured in them.

Shapes: `T` decisions, `A` agents, `Z` zones, `W` windows of decisions.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from torch_iac.space import SensorimotorSpace

CONFIG = "config.json"
STEPS = "steps"
REGIONS = "regions.parquet"
SUMMARY = "summary.json"

WINDOW = 250
"""How many decisions a window of time holds, if nobody says otherwise."""

FOCUS_SHARES = {"f3": 0.6, "f2": 0.5}
"""The share of a window that counts as a focus on a zone, for the zones of the 2004 paper."""

SETTLING = 1000
"""How many first decisions the settled shares leave out, and how many last ones errors take."""

N_AGENTS_LISTED = 64
"""How many agents a summary lists one by one."""


def load_run(folder: Path | str) -> "Run":
    """Open a run folder, of a run that has ended or still goes on.

    Raises:
        FileNotFoundError: The folder holds no run.
    """
    folder = Path(folder)
    if not (folder / CONFIG).is_file():
        raise FileNotFoundError(f"{folder} holds no run: there is no {CONFIG} in it")
    return Run(folder)


def part_path(folder: Path, number: int) -> Path:
    """Return where a run folder keeps a part of its decisions; parts count from 0."""
    return folder / STEPS / f"part-{number:05d}.parquet"


@dataclass(frozen=True)
class Run:
    """A run folder; each file is read when it is first asked for.

    Attributes:
        folder: Where it is.
    """

    folder: Path

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything needed to run it again, as `config.json` has it."""
        return _read_json(self.folder / CONFIG)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The run's measures, as `summary.json` has them; `summarise` says what they are.

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
    def seeds(self) -> tuple[int, ...]:
        """The seed of each agent."""
        return tuple(self.config["seeds"])

    @property
    def n_agents(self) -> int:
        """How many agents there are."""
        return len(self.seeds)

    @property
    def zone_names(self) -> tuple[str, ...]:
        """The names of the world's zones; none if it has no zones."""
        return tuple(self.config["zones"] or ())

    @property
    def n_decisions(self) -> int:
        """How many decisions each agent has taken so far."""
        n_rows: int = sum(_open_part(path).metadata.num_rows for path in self.parts())
        return n_rows // self.n_agents

    @cached_property
    def steps(self) -> pa.Table:
        """Every column of every decision, by step, then agent: `run.steps["error"].to_numpy()`.

        For a big run, ask for what you need: `table` and `column`.
        """
        return self.table()

    @cached_property
    def regions(self) -> pa.Table:
        """Every region ever made, by agent, then region."""
        return _read_part(self.folder / REGIONS)

    def parts(self) -> list[Path]:
        """Return the files that hold the decisions, in order.

        Raises:
            FileNotFoundError: There are none yet, or one is missing.
        """
        found = sorted((self.folder / STEPS).glob("part-*.parquet"))
        if not found:
            raise FileNotFoundError(f"{self.folder} holds no decisions yet")
        expected = [part_path(self.folder, number) for number in range(len(found))]
        missing = [path for path in expected if path not in found]
        if missing:
            raise FileNotFoundError(f"{missing[0]} is missing, though later parts are there")
        return expected

    def table(self, columns: Sequence[str] | None = None, agent: int | None = None) -> pa.Table:
        """Return some columns, by step, then agent.

        Args:
            columns: Their names; all if none are given.
            agent: The only agent to return; all if none is given.

        Raises:
            ValueError: There is no such agent or column, or a part cannot be read (it is named).
        """
        if agent is None:
            return pa.concat_tables([_read_part(path, columns) for path in self.parts()])
        self._check_agent(agent)
        return pa.concat_tables(
            part.take(np.arange(agent, part.num_rows, self.n_agents))
            for part in (_read_part(path, columns) for path in self.parts())
        )

    def column(self, name: str) -> NDArray[Any]:
        """Return one column, shape `(T, A)`; nulls become NaN."""
        values: NDArray[Any] = self.table([name])[name].to_numpy()
        return values.reshape(-1, self.n_agents)

    def family(self, agent: int = 0) -> pa.Table:
        """Return the regions of one agent; row `i` is region `i`."""
        self._check_agent(agent)
        return self.regions.filter(pc.field("agent") == agent)

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


def error_curves(run: Run, agent: int = 0, window: int = 150) -> list[ErrorCurve]:
    """Return the mean error over time of every region that has one, in order of birth.

    A child inherits its parent's errors, so its curve starts where its parent's ends.

    Args:
        run: The run.
        agent: Whose regions.
        window: How many of the region's last errors the mean is over; fewer while it has fewer.
    """
    steps = run.table(["error", "region"], agent)
    errors = steps["error"].to_numpy()
    own_decisions = _decisions_by_region(steps["region"].to_numpy())
    nothing = np.empty(0, dtype=np.int64)
    last_errors: dict[int, NDArray[np.float64]] = {-1: np.empty(0)}
    curves = []
    for row in run.family(agent).to_pylist():
        region, inherited = row["region"], last_errors[row["parent"]]
        own = own_decisions.get(region, nothing)
        history = np.concatenate([inherited, errors[own]])
        last_errors[region] = history[-window:]
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
    """Return a region's parent, its parent's parent and so on to the root."""
    parents = run.family(agent)["parent"].to_numpy()
    line = []
    while (region := int(parents[region])) >= 0:
        line.append(region)
    return tuple(line)


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
    """Return the zone that each region of an agent mostly covers."""
    steps = run.table(["region", "zone"], agent)
    counts = np.zeros((run.family(agent).num_rows, len(run.zone_names)))
    np.add.at(counts, (steps["region"].to_numpy(), steps["zone"].to_numpy()), 1)
    total = counts.sum(axis=1)
    share = np.divide(counts.max(axis=1), total, out=np.full(len(total), np.nan), where=total > 0)
    return RegionZones(np.where(total > 0, counts.argmax(axis=1), -1), share)


def zone_shares(run: Run, window: int = WINDOW) -> NDArray[np.float64]:
    """Return the share of its time that each agent spends in each zone, window after window.

    Args:
        run: The run.
        window: Decisions a window; a last window that is not full is left out.

    Returns:
        Shape `(W, A, Z)`.

    Raises:
        ValueError: The world has no zones.
    """
    zones = run.column("zone")
    n_windows = len(zones) // window
    windows = zones[: n_windows * window].reshape(n_windows, window, run.n_agents)
    return _shares(windows, len(run.zone_names), axis=1)


def focus_steps(run: Run, zone: str, share: float, window: int = WINDOW) -> list[int | None]:
    """Return when each agent first focuses on a zone: spends more than `share` of a window in it.

    Returns:
        The first decision of that window, agent by agent; None for an agent that never does.
    """
    focused = zone_shares(run, window)[:, :, run.zone_names.index(zone)] > share
    return [int(mine.argmax()) * window if mine.any() else None for mine in focused.T]


def summarise(run: Run, seconds: float) -> dict[str, Any]:
    """Return the measures of a run, as `summary.json` holds them.

    Shares and errors are means over agents, first cuts and focuses count agents and give medians;
    `agents` has the same agent by agent, for the first `N_AGENTS_LISTED`. What a short run does
    not have is None.

    Args:
        run: The run.
        seconds: How long it took, by the clock on the wall.
    """
    n_decisions, n_regions = run.n_decisions, _n_regions(run)
    by_zone, cuts, focus = _measures_by_zone(run), _first_cuts(run), _focus(run)
    return {
        "n_agents": run.n_agents,
        "n_decisions": n_decisions,
        "seconds": seconds,
        "decisions_per_second": n_decisions / seconds,
        "n_regions": float(n_regions.mean()),
        **_each_zone(by_zone, lambda values: float(_mean(values))),
        "first_cuts": _count_first_cuts(cuts),
        "focus": {zone: _count_focus(steps) for zone, steps in focus.items()},
        "agents": [
            {
                "seed": run.seeds[agent],
                "n_regions": int(n_regions[agent]),
                **_each_zone(by_zone, itemgetter(agent)),
                "first_cut": cuts[agent],
                "focus": {zone: steps[agent] for zone, steps in focus.items()},
            }
            for agent in range(min(run.n_agents, N_AGENTS_LISTED))
        ],
    }


def _measures_by_zone(run: Run) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return each measure of each zone, shape `(A,)`; NaN where there is nothing to measure."""
    if not run.zone_names:
        return {}
    zones, errors = run.column("zone"), run.column("error")[-SETTLING:]
    n_zones = len(run.zone_names)
    in_zone = [zones[-SETTLING:] == zone for zone in range(n_zones)]
    measures = {
        "zone_shares": _shares(zones, n_zones, axis=0),
        "settled_zone_shares": _shares(zones[SETTLING:], n_zones, axis=0),
        "late_zone_errors": np.stack([_mean(errors, axis=0, where=here) for here in in_zone], -1),
    }
    return {
        measure: dict(zip(run.zone_names, values.T, strict=True))
        for measure, values in measures.items()
    }


def _each_zone(
    by_zone: dict[str, dict[str, NDArray[np.float64]]],
    pick: Callable[[NDArray[np.float64]], float],
) -> dict[str, dict[str, float | None]]:
    """Return one number for each measure and zone, picked from those of all agents."""
    return {
        measure: {zone: _number(pick(values)) for zone, values in zones.items()}
        for measure, zones in by_zone.items()
    }


def _n_regions(run: Run) -> NDArray[np.int64]:
    """Return how many regions each agent's cube is in at last, shape `(A,)`."""
    is_leaf = run.regions["split_step"].to_numpy() < 0
    return np.bincount(run.regions["agent"].to_numpy()[is_leaf], minlength=run.n_agents)


def _first_cuts(run: Run) -> list[dict[str, Any] | None]:
    """Return how the root of each agent was cut; None for one that was not."""
    roots = run.regions.filter(pc.field("parent") < 0).to_pylist()
    return [
        {"dimension": r["cut_dimension"], "value": r["cut_value"], "step": r["split_step"]}
        if r["split_step"] >= 0
        else None
        for r in roots
    ]


def _count_first_cuts(first_cuts: list[dict[str, Any] | None]) -> dict[str, dict[str, Any]]:
    """Return how many agents first cut along each dimension, and where and when they did."""
    cuts = [cut for cut in first_cuts if cut is not None]
    groups = {
        name: [cut for cut in cuts if cut["dimension"] == name]
        for name in sorted({cut["dimension"] for cut in cuts})
    }
    return {
        name: {
            "n_agents": len(group),
            "median_value": float(np.median([cut["value"] for cut in group])),
            "median_step": float(np.median([cut["step"] for cut in group])),
        }
        for name, group in groups.items()
    }


def _count_focus(steps: list[int | None]) -> dict[str, Any]:
    """Return how many agents ever focus, and when they do."""
    reached = [step for step in steps if step is not None]
    return {"n_agents": len(reached), "median_step": float(np.median(reached)) if reached else None}


def _focus(run: Run) -> dict[str, list[int | None]]:
    """Return when each agent first focuses on each zone of `FOCUS_SHARES`."""
    return {
        zone: focus_steps(run, zone, share)
        for zone, share in FOCUS_SHARES.items()
        if zone in run.zone_names
    }


def _shares(zones: NDArray[np.int8], n_zones: int, axis: int) -> NDArray[np.float64]:
    """Return the share of each zone along an axis, as a new last axis."""
    return np.stack([_mean(zones == zone, axis=axis) for zone in range(n_zones)], axis=-1)


def _mean(
    values: NDArray[Any], axis: int | None = None, where: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the mean of what is not NaN (and where asked); NaN, not a warning, for nothing."""
    counted = np.isfinite(values) if where is None else where & np.isfinite(values)
    n_counted = counted.sum(axis=axis)
    total = np.sum(values, axis=axis, where=counted, dtype=np.float64)
    nothing = np.full(np.shape(total), np.nan)
    return np.asarray(np.divide(total, n_counted, out=nothing, where=n_counted > 0))


def _number(value: float) -> float | None:
    """Return a plain number, or None for NaN, which JSON does not have."""
    return None if np.isnan(value) else float(value)


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
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content
