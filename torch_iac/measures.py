"""What is measured in a run, for its summary.

Shapes: `T` decisions, `A` agents, `Z` zones.
"""

from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from torch_iac.runs import Run, focus_steps

FOCUS_SHARES = {"f3": 0.6, "f2": 0.5}
"""The share of a window that counts as a focus on a zone, for the zones of the 2004 paper."""

SETTLING = 1000
"""How many first decisions the settled shares leave out, and how many last ones errors take."""

N_AGENTS_LISTED = 64
"""How many agents a summary lists one by one."""


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
        "zone_shares": _shares(zones, n_zones),
        "settled_zone_shares": _shares(zones[SETTLING:], n_zones),
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


def _shares(zones: NDArray[np.int8], n_zones: int) -> NDArray[np.float64]:
    """Return the share of each zone among decisions `(T, A)`, shape `(A, Z)`."""
    return np.stack([_mean(zones == zone, axis=0) for zone in range(n_zones)], axis=-1)


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
