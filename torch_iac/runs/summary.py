"""The measures in a run's summary.

Shapes: `T` decisions, `A` agents, `Z` zones.
"""

from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from torch_iac.runs.reader import Run
from torch_iac.runs.schema import USED_NETWORK, WINDOW
from torch_iac.runs.statistics import Expectation, calibration, focus_steps, known_mean
from torch_iac.toy_room import FOCUS_SHARES

SETTLING = 1000
"""How many first decisions the settled shares leave out, and how many last ones errors take, from
the beginning of a window on; a multiple of `WINDOW`."""

N_AGENTS_LISTED = 64
"""How many agents a summary lists one by one."""


def summarise(run: Run, seconds: float) -> dict[str, Any]:
    """Return the measures of a run, as `summary.json` holds them.

    Shares and errors are means over all agents, first cuts and focuses count agents and give
    medians; `agents` has the same agent by agent, for the first `N_AGENTS_LISTED`. `errors` are
    those of the last `SETTLING` decisions, from the beginning of a window on, of the main experts
    and of each shadow; `network_share` is the share of the same decisions for which hybrid experts
    used the network. Only `calibration` is over the agents whose steps are recorded. What a short
    run, or one without MP, does not have is None.

    Args:
        run: The run.
        seconds: How long it took (s), in wall-clock time.
    """
    n_decisions, n_regions = run.n_decisions, count_regions(run)
    by_zone, cuts, focus = _measures_by_zone(run), _first_cuts(run), _focus(run)
    errors = {name: _late_errors(run, column) for name, column in run.error_columns.items()}
    network_shares = {"network_share": _late_errors(run, USED_NETWORK)} if run.is_hybrid else {}
    return {
        "n_agents": run.n_agents,
        "n_recorded_agents": run.n_recorded,
        "n_decisions": n_decisions,
        "seconds": seconds,
        "decisions_per_second": n_decisions / seconds,
        "n_regions": float(n_regions.mean()),
        **_each_zone(by_zone, lambda values: float(known_mean(values))),
        "errors": {
            name: _describe_errors(run, known_mean(e, axis=0)) for name, e in errors.items()
        },
        **{
            name: _describe_errors(run, known_mean(s, axis=0)) for name, s in network_shares.items()
        },
        "calibration": _calibration(run),
        "first_cuts": _count_first_cuts(cuts),
        "focus": {zone: _count_focus(steps) for zone, steps in focus.items()},
        "agents": [
            {
                "seed": run.seeds[agent],
                "n_regions": int(n_regions[agent]),
                **_each_zone(by_zone, itemgetter(agent)),
                "errors": {name: _describe_errors(run, e[agent]) for name, e in errors.items()},
                **{name: _describe_errors(run, s[agent]) for name, s in network_shares.items()},
                "first_cut": cuts[agent],
                "focus": {zone: steps[agent] for zone, steps in focus.items()},
            }
            for agent in range(min(run.n_agents, N_AGENTS_LISTED))
        ],
    }


def _measures_by_zone(run: Run) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return each measure of each zone, shape `(A,)`; NaN without data."""
    if not run.zone_names:
        return {}
    measures = {
        "zone_shares": _shares(run),
        "settled_zone_shares": _shares(run, SETTLING // WINDOW),
        "late_zone_errors": _late_errors(run, "error")[:, 1:],
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


def _late_errors(run: Run, column: str) -> NDArray[np.float64]:
    """Return each agent's recent mean error, in all and in each zone, shape `(A, 1 + Z)`."""
    first = max(0, run.n_decisions - SETTLING) // WINDOW
    late = run.window_sums[first:].total(0)
    by_zone = late.means(column)[0, :, : len(run.zone_names)]
    return np.concatenate([late.total(2).means(column)[0], by_zone], axis=1)


def _describe_errors(run: Run, errors: NDArray[np.float64]) -> dict[str, Any]:
    """Return errors, shape `(1 + Z,)`, under their names."""
    overall, *by_zone = map(_number, errors.tolist())
    return {"mean": overall, "zones": dict(zip(run.zone_names, by_zone, strict=True))}


def _calibration(run: Run) -> dict[str, Any] | None:
    """Return how calibrated MP is, if there is one."""
    if not run.has_expectations:
        return None
    found = calibration(run)
    return {
        "first_step": found.first_step,
        **_describe_expectation(found.overall),
        "zones": {zone: _describe_expectation(of) for zone, of in found.zones.items()},
        "deciles": {
            "expected": [_number(value) for value in found.expected.tolist()],
            "actual": [_number(value) for value in found.actual.tolist()],
        },
    }


def _describe_expectation(of: Expectation) -> dict[str, float | None]:
    return {
        "expected": _number(of.expected),
        "actual": _number(of.actual),
        "ratio": _number(of.ratio),
        "n": of.n_decisions,
    }


def count_regions(run: Run) -> NDArray[np.int64]:
    """Return each agent's number of regions at the end, shape `(A,)`."""
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


def _shares(run: Run, first: int = 0) -> NDArray[np.float64]:
    """Return the share of its time that each agent spends in each zone, shape `(A, Z)`.

    Args:
        run: The run.
        first: The first window that counts.
    """
    counts = run.window_sums.counts[first:].sum(axis=0)
    n_decisions = counts.sum(axis=1, keepdims=True)
    nothing = np.full(counts.shape, np.nan)
    return np.asarray(np.divide(counts, n_decisions, out=nothing, where=n_decisions > 0))


def _number(value: float) -> float | None:
    """Return a plain number, or None for NaN, which JSON does not have."""
    return None if np.isnan(value) else float(value)
