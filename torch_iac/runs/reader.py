"""Reads a run folder: its config, decisions, windows and regions.

Shapes: `T` decisions, `A` agents, `Z` zones, `W` windows of decisions, `R` regions of an agent, `P`
points of a curve.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from torch_iac.internal.files import open_table, parse_json
from torch_iac.internal.validation import check_count, settled
from torch_iac.runs.schema import (
    CONFIG,
    MAIN,
    REGIONS,
    STEPS,
    SUMMARY,
    WINDOW,
    WINDOWS,
    part_path,
    shadow_error,
    sum_columns,
    summed_fields,
)
from torch_iac.runs.window_sums import WindowSums
from torch_iac.space import SensorimotorSpace

ERROR_WINDOW, DELAY = 150, 150
"""Over how many errors a mean error is taken, and how many lie between the two means that make
learning progress, in a run whose config does not say."""


IN_CONFIG: dict[str, Any] = {
    "space": Mapping[str, Mapping[str, tuple[float, ...]]],
    "seeds": tuple[int, ...],
    "zones": tuple[str, ...] | None,
    "n_recorded": int,
    "shadows": tuple[str, ...],
    "iac": Mapping[str, Any],
    "bounds": Mapping[str, tuple[str, ...]],
}
"""What the parts of `config.json` are that a run is read by."""

IN_IAC: dict[str, Any] = {
    "window": int,
    "delay": int,
    "inherit_history": bool,
    "experts": Mapping[str, Any],
}
"""Of its `iac`."""


def load_run(folder: Path | str) -> "Run":
    """Open a run folder, of a run that has ended or still goes on.

    Raises:
        FileNotFoundError: The folder holds no run.
    """
    folder = Path(folder)
    if not (folder / CONFIG).is_file():
        raise FileNotFoundError(f"{folder} holds no run: there is no {CONFIG} in it")
    return Run(folder)


@dataclass(frozen=True)
class Run:
    """A run folder; each file is read when it is first asked for.

    Attributes:
        folder: Where it is.
    """

    folder: Path

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything needed to make it again, as in `config.json`.

        Raises:
            ValueError: The file is not the config of a run.
        """
        path = self.folder / CONFIG
        config = _read_json(path)
        missing = [key for key in ("space", "seeds", "zones") if key not in config]
        if missing:
            raise ValueError(f"{path} must be the config of a run, but it has no {missing[0]}")
        try:
            _check_config(config)
        except ValueError as error:
            raise ValueError(f"{path} must be the config of a run: {error}") from None
        return config

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The run's measures, as in `summary.json`; `summary.summarise` explains them.

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
        return int(self.config.get("n_recorded", self.n_agents))

    @property
    def zone_names(self) -> tuple[str, ...]:
        """The names of the world's zones; none if it has no zones."""
        return tuple(self.config["zones"] or ())

    @property
    def shadow_names(self) -> tuple[str, ...]:
        """The names of the shadow experts."""
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
    def is_hybrid(self) -> bool:
        """Whether the experts are `HybridExperts`, which say which half they used."""
        experts = self.config.get("iac", {}).get("experts", {})
        return bool(experts.get("kind") == "HybridExperts")

    @property
    def n_decisions(self) -> int:
        """How many decisions each agent has taken so far."""
        n_rows: int = sum(open_table(path).metadata.num_rows for path in self.parts())
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
    def windows(self) -> pa.Table:
        """What every agent did, recorded or not, in each `WINDOW` decisions and zone.

        A row for each window, agent and zone (one, called all, where the world has none): `step`,
        the window's first; `agent`, `seed`, `zone`; `decisions`, how many there; the means of
        `error`, `expected_error` and `progress` over them, NaN where there are none.
        `run.windows.to_pandas()` is a frame.

        Raises:
            FileNotFoundError: There are no windows yet, or a part is missing.
            ValueError: A part cannot be read.
        """
        sums = self.window_sums
        zones = self.zone_names or ("all",)
        shape = sums.counts.shape
        steps, agents, places = (axis.ravel() for axis in np.indices(shape))
        return pa.table(
            {
                "step": steps * WINDOW,
                "agent": agents.astype(np.int32),
                "seed": np.asarray(self.seeds)[agents],
                "zone": np.asarray(zones)[places],
                "decisions": sums.counts.ravel(),
                **{name: sums.means(name).ravel() for name in sums.sums},
            }
        )

    def region_progress(self, every: int = WINDOW) -> pa.Table:
        """Return what the recorded agents did, region by region, in each `every` decisions.

        A row for each window, agent, region and zone where there was a decision: `step`, the
        window's first; `agent`, `region`, `zone` (as text, if the world has zones); `decisions`,
        how many there; the means of `progress` and of `error` over them.

        Raises:
            ValueError: `every` is below 1, or a part cannot be read.
        """
        check_count("every", every)
        keys = ["step", "agent", "region", *(["zone"] if self.zone_names else [])]
        table = self.table([*keys, "progress", "error"])
        first = pc.multiply(pc.divide(table["step"], every), every)
        table = table.set_column(table.schema.get_field_index("step"), "step", first)
        grouped = table.group_by(keys, use_threads=False).aggregate(
            [([], "count_all"), ("progress", "mean"), ("error", "mean")]
        )
        grouped = grouped.rename_columns([*keys, "decisions", "progress", "error"])
        grouped = grouped.sort_by([(key, "ascending") for key in keys])
        if not self.zone_names:
            return grouped
        zones = pa.array(self.zone_names).take(grouped["zone"].combine_chunks())
        return grouped.set_column(keys.index("zone"), "zone", zones)

    @cached_property
    def window_sums(self) -> WindowSums:
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

        fields = summed_fields(self.shadow_names, self.is_hybrid)
        counts, *sums = map(by_window, sum_columns(fields, self.zone_names))
        return WindowSums(counts, dict(zip(fields, sums, strict=True)))

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

    def columns(self, names: Iterable[str]) -> NDArray[Any]:
        """Return some columns of the recorded agents, shape `(T, A, columns)`; nulls are NaN.

        Raises:
            ValueError: There is no such column, or a part cannot be read.
        """
        return np.stack([self.column(name) for name in names], axis=-1)

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


def _first_decisions(windows: pa.Table) -> NDArray[np.int64]:
    """Return the first decision of each window in a part, whose rows are by window, then agent."""
    steps: NDArray[np.int64] = windows.filter(pc.field("agent") == 0)["step"].to_numpy()
    return steps


def _read_part(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    part = open_table(path)
    unknown = set(columns or ()) - set(part.schema_arrow.names)
    if unknown:
        raise ValueError(f"{path} has no column {sorted(unknown)[0]}")
    try:
        return part.read(columns)
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


def _check_config(config: Mapping[str, Any]) -> None:
    """Refuse a config whose parts are not of the types that a recorder writes."""
    for part, hints in ((config, IN_CONFIG), (config.get("iac", {}), IN_IAC)):
        for name in hints.keys() & part.keys():
            settled(name, part[name], hints[name])
    for name in ("actions", "sensors", "outcomes"):
        if name not in config["space"]:
            raise ValueError(f"space must have {name}, got none")
    SensorimotorSpace.from_json(config["space"])
    n_agents = len(config["seeds"])
    if not 1 <= config.get("n_recorded", n_agents) <= n_agents:
        raise ValueError(f"n_recorded must lie in [1, {n_agents}], got {config['n_recorded']}")


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = parse_json(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} must hold names and values, got {str(content)[:80]}")
    return content
