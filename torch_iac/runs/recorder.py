"""Writes a run folder: its decisions, its windows, its regions, TensorBoard, a summary.

Of every agent, each window of decisions is summed up; of a large population, only the first
agents' decisions one by one.

Every file is written under a temporary name, fsynced and renamed, so whatever has its final name is
whole, also after a crash. Shapes: `A` agents, `T` decisions in one part, `S` regions.
"""

import platform
import time
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Protocol, Self

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from torch_iac.config import IACConfig
from torch_iac.experts.hybrid import HybridExperts
from torch_iac.internal.files import FolderLock, dump_json, remove_temporary, replace, write_table
from torch_iac.internal.processor import processor
from torch_iac.internal.torch_defaults import with_torch_defaults
from torch_iac.internal.validation import check_count, whole
from torch_iac.records import Genealogy, RegionSummary, Step
from torch_iac.runs.buffer import N_LOGGED_AGENTS, ROWS_PER_PART, Rows, decisions_per_part
from torch_iac.runs.present import present_line
from torch_iac.runs.reader import load_run
from torch_iac.runs.schema import (
    CONFIG,
    EVENTS,
    REGIONS,
    RESERVED,
    STEPS,
    SUMMARY,
    WINDOW,
    WINDOWS,
    part_path,
    region_table,
    sum_columns,
    summed_fields,
)
from torch_iac.runs.summary import summarise
from torch_iac.runs.tensorboard import Dashboard
from torch_iac.runs.window_sums import RunningSums, WindowSums
from torch_iac.space import SensorimotorSpace

LOGS_PER_DOUBLING = 500
"""The logging interval doubles each time the run doubles: logs between two doublings."""


PACKAGES = ("torch_iac", "torch", "numpy", "gymnasium", "pybullet", "pybullet-arm64", "mujoco")
"""Packages whose versions are in config.json."""

KEYS = "versions", "processor", "iac", "space", "seeds", "zones", "shadows", "n_recorded"
"""Keys in config.json that the recorder writes itself."""


class Recorded(Protocol):
    """The protocol of agents that can be recorded; `IAC` is one."""

    @property
    def space(self) -> SensorimotorSpace:
        """What the agents do, sense and predict."""

    @property
    def config(self) -> IACConfig:
        """The numbers of the algorithm."""

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each agent."""

    @property
    def shadows(self) -> Mapping[str, Any]:
        """The shadow experts, by name."""

    def genealogy(self) -> Genealogy:
        """Return every region ever made."""

    def region_summary(self, n_agents: int | None = None) -> RegionSummary:
        """Return what each present leaf of the first so many agents knows, or of all."""


class Recorder:
    """Writes a run folder, decision by decision; a context manager.

    ```python
    with Recorder(Path("runs/a"), agent) as recorder:
        for _ in range(10_000):
            ...
            recorder.record(agent.observe(sensors))
    ```

    Leaving the block without an error writes `summary.json`: a folder that has one holds a run that
    went to its end. Leaving it with an error writes the decisions taken until then.

    TensorBoard shows aggregates over all agents, measures of regions over the first
    `N_LOGGED_AGENTS` and, region by region, agent 0.

    A run that was interrupted goes on with `resume=True` and `load_state`; the parts on disk that
    lie ahead are the same that will be written, and stay until they are.

    A step is copied on its own device; from a GPU, data are transferred only when a log or a part
    is due.

    Args:
        folder: Where to write; made if it is not there.
        agent: The population that is recorded.
        zone_names: The names of the world's zones, if it has any.
        config: Further content of `config.json`, besides the agent's config, space and seeds, the
            zones, the names of the shadows, versions and the kind of processor.
        log_every: How many decisions lie between two logs to TensorBoard, at first; in a long run
            they become fewer, as `log_interval` says.
        rows_per_part: At most so many rows (a decision of an agent) are kept in memory.
        n_recorded: Of how many agents, the first, every decision is recorded; of all by default.
        resume: Whether the folder holds this run already, begun before.

    Raises:
        BlockingIOError: Another process writes into the folder.
        FileExistsError: The folder already holds a run, and it is not to be resumed.
        NotADirectoryError: The folder is a file, or would lie in one.
        ValueError: `log_every` or `rows_per_part` is below 1, `n_recorded` is not in [1, A], or a
            shadow has a name of `RESERVED`.
    """

    @with_torch_defaults
    def __init__(
        self,
        folder: Path,
        agent: Recorded,
        zone_names: Sequence[str] | None = None,
        config: Mapping[str, Any] | None = None,
        *,
        log_every: int = 100,
        rows_per_part: int = ROWS_PER_PART,
        n_recorded: int | None = None,
        resume: bool = False,
    ) -> None:
        for name, value in (("log_every", log_every), ("rows_per_part", rows_per_part)):
            check_count(name, value)
        n_agents = len(agent.seeds)
        n_recorded = n_agents if n_recorded is None else whole("n_recorded", n_recorded)
        for seed in (min(agent.seeds), max(agent.seeds)):
            if not -(2**63) <= seed < 2**63:
                raise ValueError(f"seeds must fit into 64 bits to be recorded, got {seed}")
        if not 1 <= n_recorded <= n_agents:
            raise ValueError(f"n_recorded must lie in [1, {n_agents}], got {n_recorded}")
        shadows = tuple(agent.shadows)
        for name in shadows:
            if name in RESERVED:
                raise ValueError(f"shadows must not be called {', '.join(RESERVED)}, got {name}")
        self.folder = Path(folder)
        self._lock = _claim(self.folder, resume)
        known = {
            "versions": {"python": platform.python_version(), **_versions()},
            "processor": _processor(self.folder) if resume else processor(),
            "iac": agent.config.to_json(),
            "space": agent.space.to_json(),
            "seeds": agent.seeds,
            "zones": zone_names,
            "shadows": shadows,
            "n_recorded": n_recorded,
        }
        write_config(self.folder, {**(config or {}), **known})
        is_hybrid = isinstance(agent.config.experts, HybridExperts)
        self._agent, self._log_every = agent, log_every
        self._seeds, self._zone_names = np.array(agent.seeds, np.int64), tuple(zone_names or ())
        self._rows = Rows(
            decisions_per_part(n_recorded, rows_per_part),
            agent.space,
            agent.seeds[:n_recorded],
            shadows,
            zone_names is not None,
            is_hybrid,
        )
        self._summed = summed_fields(shadows, is_hybrid)
        self._sums = RunningSums(n_agents, len(self._zone_names), self._summed)
        self._windows: dict[int, WindowSums] = {}  # not yet on disk, by their first decision
        self._first_decision = -1  # from which windows are counted
        self._n_parts = self._n_told = 0
        self._dashboard = Dashboard(
            self.folder, agent.space, min(N_LOGGED_AGENTS, n_agents), self._zone_names, shadows
        )
        self._started = time.perf_counter()

    @with_torch_defaults
    def state(self) -> dict[str, Any]:
        """Return the whole state, what is not yet on disk included, as `serialize` can pack it."""
        return {
            "n_parts": self._n_parts,
            "n_told": self._n_told,
            "first_decision": self._first_decision,
            "seconds": time.perf_counter() - self._started,
            "rows": self._rows.state(),
            "sums": self._sums.state(),
            "windows": [[start, of.counts, of.sums] for start, of in self._windows.items()],
            "dashboard": self._dashboard.state(),
        }

    @with_torch_defaults
    def load_state(self, state: Mapping[str, Any] | None, n_decisions: int) -> None:
        """Go on from what `state` returned, or from the beginning.

        Args:
            state: What `state` returned; None to start anew.
            n_decisions: How many decisions had been taken then.
        """
        self._dashboard.load_state(state["dashboard"] if state else None, n_decisions)
        if state:
            self._n_parts, self._n_told = state["n_parts"], state["n_told"]
            self._first_decision = state["first_decision"]
            self._started -= state["seconds"]
            self._rows.load_state(state["rows"])
            self._sums.load_state(state["sums"])
            self._windows = {start: WindowSums(*of) for start, *of in state["windows"]}

    @with_torch_defaults
    def record(self, step: Step, zones: NDArray[Any] | Tensor | None = None) -> None:
        """Keep one decision of every agent.

        Args:
            step: What `observe` returned.
            zones: Shape `(A,)`, the zone of the world that each was in; None without zones.

        Raises:
            ValueError: Zones are missing, there are zones and the world has none, or there is no
                such zone (which on a GPU is not checked).
        """
        if (zones is not None) != self._rows.has_zones:
            raise ValueError("record needs zones if, and only if, the recorder has zone_names")
        on_device = None if zones is None else torch.as_tensor(zones, device=step.errors.device)
        self._sums.add(on_device, _summed_values(step))  # which refuses an unknown zone
        self._rows.add(step, on_device)
        if self._first_decision < 0:
            self._first_decision = step.number
        n_decisions = step.number + 1
        is_log_due = n_decisions % log_interval(n_decisions, self._log_every) == 0
        if is_log_due or (n_decisions - self._first_decision) % WINDOW == 0:
            self._settle()
        if is_log_due:
            summary = self._agent.region_summary(N_LOGGED_AGENTS)
            self._dashboard.log(n_decisions, summary, self._agent.genealogy)
        if self._rows.is_full:
            self.flush()

    @with_torch_defaults
    def present(self) -> str:
        """Return what the robots did in the last `WINDOW` decisions and where they learn most now.

        A line of text; nothing before the first decision.
        """
        errors = self._rows.last(WINDOW, "errors")
        if not len(errors):
            return ""
        zones = self._rows.last(WINDOW, "zones") if self._rows.has_zones else None
        regions = self._agent.region_summary(N_LOGGED_AGENTS)
        return present_line(errors, zones, self._zone_names, regions, self._dashboard.zone_of)

    @with_torch_defaults
    def flush(self) -> None:
        """Write what is kept in memory; when it returns, all decisions so far are on disk.

        Raises:
            OSError: The disk refuses it.
        """
        if not self._rows.count:
            return
        self._settle()
        regions = region_table(self._agent.genealogy(), self._agent.space)
        write_table(self.folder / REGIONS, regions)
        write_table(part_path(self.folder, self._n_parts, WINDOWS), self._window_table())
        write_table(part_path(self.folder, self._n_parts), self._rows.table())
        self._rows.clear()
        self._windows.clear()
        self._n_parts, self._n_told = self._n_parts + 1, 0
        self._dashboard.flush()

    @with_torch_defaults
    def close(self) -> None:
        """Write the rest and `summary.json`; nothing can be recorded any more."""
        seconds = time.perf_counter() - self._started
        self.flush()
        self._dashboard.close()
        if self._n_parts:
            measures = summarise(load_run(self.folder), seconds)
            _write_json(self.folder / SUMMARY, measures)
        self._lock.release()

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled.

        Raises:
            TypeError: Always.
        """
        raise TypeError(f"a recorder must not be copied, since it writes into {self.folder}")

    def _settle(self) -> None:
        """Add what was summed up since the last time, all in one window, to that window."""
        if self._n_told == self._rows.count:
            return
        last = self._rows.last_decision
        start = last - (last - self._first_decision) % WINDOW
        taken, known = self._sums.drain(), self._windows.get(start)
        self._windows[start] = taken if known is None else known + taken
        self._dashboard.add(taken, self._rows.since(self._n_told))
        self._n_told = self._rows.count

    def _window_table(self) -> pa.Table:
        """Return the rows of the windows that are kept, by window, then agent."""
        n_agents, n_windows = len(self._seeds), len(self._windows)
        all_sums = list(self._windows.values())
        blocks = [
            np.concatenate([sums.counts for sums in all_sums]),
            *(np.concatenate([sums.sums[name] for sums in all_sums]) for name in self._summed),
        ]
        columns = {
            "step": np.repeat(np.array(list(self._windows), np.int64), n_agents),
            "agent": np.tile(np.arange(n_agents, dtype=np.int32), n_windows),
            "seed": np.tile(self._seeds, n_windows),
        }
        names = sum_columns(self._summed, self._zone_names)
        for block, of_block in zip(blocks, names, strict=True):
            columns |= dict(zip(of_block, block.T, strict=True))
        return pa.table({name: pa.array(c, from_pandas=True) for name, c in columns.items()})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            try:
                self.flush()
            finally:
                self._dashboard.close()
                self._lock.release()


def log_interval(n_decisions: int, log_every: int) -> int:
    """Return how many decisions lie between two logs to TensorBoard, at a point of a run.

    `log_every`, doubled each time that the decisions taken double beyond the first
    `LOGS_PER_DOUBLING` intervals, twice.
    """
    octave = n_decisions // (log_every * LOGS_PER_DOUBLING)
    return log_every << max(0, octave.bit_length() - 1)


def _versions() -> dict[str, str]:
    """Return the versions of what a run depends on, as far as it is installed."""
    return {name: found.version for name in PACKAGES for found in metadata.distributions(name=name)}


def _processor(folder: Path) -> Any:
    """Return the kind of processor that a run began on."""
    try:
        return load_run(folder).config.get("processor")
    except FileNotFoundError:  # it was killed before it wrote its config
        return processor()


def write_config(folder: Path, config: Mapping[str, Any]) -> None:
    """Write `config.json`."""
    _write_json(folder / CONFIG, config)


def _summed_values(step: Step) -> list[Tensor]:
    """Return the values that windows sum up, in the order of `summed_fields`."""
    expected = step.expected_errors
    unknown = torch.full_like(step.errors, torch.nan) if expected is None else expected
    values = [step.errors, unknown, step.progress, *(shadow.errors for shadow in step.shadows)]
    return values if step.used_network is None else [*values, step.used_network.double()]


def _claim(folder: Path, resume: bool) -> FolderLock:
    """Make a folder ready for a run, unless it already holds another one, and lock it."""
    files = [path for path in (folder, *folder.parents) if path.is_file()]
    if files:
        raise NotADirectoryError(f"{folder} cannot be a run folder: {files[0]} is a file")
    if not resume:
        _check_free(folder)  # before anything in it is touched
    folder.mkdir(parents=True, exist_ok=True)
    lock = FolderLock(folder)
    try:
        if not resume:
            _check_free(folder)  # another process may have begun a run in it since
        (folder / SUMMARY).unlink(missing_ok=True)  # its presence means that a run has ended
        for kind in (STEPS, WINDOWS):
            (folder / kind).mkdir(exist_ok=resume)
        for place in (folder, folder / STEPS, folder / WINDOWS):
            remove_temporary(place)  # of a run that was killed
    except BaseException:
        lock.release()
        raise
    return lock


def _check_free(folder: Path) -> None:
    """Refuse a folder that holds a run."""
    held = any((folder / name).exists() for name in (CONFIG, REGIONS, SUMMARY, STEPS))
    if held or any(folder.glob(EVENTS)):
        raise FileExistsError(f"{folder} already holds a run; resume it or choose another folder")


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    data = dump_json(content)
    replace(path, lambda temporary: temporary.write_bytes(data))
