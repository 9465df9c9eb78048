"""The lines that `torch-iac train` prints at the end of a run."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from torch_iac.runs.reader import Run
from torch_iac.runs.schema import WINDOW

OFTEN_CLIPPED, N_CLIPPED_SHOWN = 0.01, 3
"""Sensors clipped in a larger share of the decisions are reported, and so many named.
"""


def report_of(run: Run) -> str:
    """Return the lines: what the robots did, and where to look."""
    summary = run.summary
    who = "The robot" if run.n_agents == 1 else f"Each of {run.n_agents:,} robots"
    lines = [
        f"{who} took {run.n_decisions:,} decisions in {summary['seconds']:.0f} s "
        f"({summary['decisions_per_second']:.0f} a second) "
        f"and made {summary['n_regions']:.0f} region{'s' if summary['n_regions'] != 1 else ''}."
    ]
    for name, cuts in summary["first_cuts"].items():
        lines.append(
            f"First cut: {name} at {cuts['median_value']:.3g}, "
            f"at decision {cuts['median_step']:.0f}{_share(cuts, run)}."
        )
    for zone, focus in summary["focus"].items():
        if focus["n_agents"]:
            lines.append(
                f"Focus on {zone}: from decision {focus['median_step']:.0f}{_share(focus, run)}."
            )
        else:
            lines.append(f"Focus on {zone}: never.")
    if "zone_shares" in summary:
        shares = ", ".join(f"{zone} {share:.0%}" for zone, share in summary["zone_shares"].items())
        lines.append(f"Time: {shares}.")
    if run.n_recorded < run.n_agents:
        lines.append(
            f"Every decision is recorded of the first {run.n_recorded} robots, "
            f"windows of {WINDOW} decisions of all {run.n_agents:,}."
        )
    clipped = _clipped(run)
    if clipped:
        worst = sorted(clipped, key=clipped.__getitem__, reverse=True)[:N_CLIPPED_SHOWN]
        shares = ", ".join(f"{name} {clipped[name]:.0%}" for name in worst)
        more = f" and {len(clipped) - len(worst)} more" if len(clipped) > len(worst) else ""
        lines.append(f"At their bounds or beyond: {shares}{more}; see --sensor-bounds.")
    lines.append(f"Look at {run.folder / 'figures'}, or: tensorboard --logdir {run.folder.parent}")
    return "\n".join(lines)


def _clipped(run: Run) -> dict[str, float]:
    """Return the sensors that were often clipped, each with its share of the decisions."""
    names = [name for of in run.config.get("bounds", {}).values() for name in of]
    clipped = [sensor for sensor in run.space.sensors if sensor.name in names]
    shares = {}
    for sensor in clipped:
        read = run.column(f"sensor/{sensor.name}")
        at_bound = (read <= np.float32(sensor.low)) | (read >= np.float32(sensor.high))
        shares[sensor.name] = float(at_bound.mean())
    return {name: share for name, share in shares.items() if share >= OFTEN_CLIPPED}


def _share(count: Mapping[str, Any], run: Run) -> str:
    return "" if run.n_agents == 1 else f" (median; {count['n_agents']} of {run.n_agents} robots)"
