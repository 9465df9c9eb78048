"""What robots do now, in one line for the progress bar and the log.

Shapes: `T` decisions, `A` agents.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torch_iac.records import RegionSummary


def present_line(
    errors: NDArray[np.float64],
    zones: NDArray[np.integer[Any]] | None,
    zone_names: Sequence[str],
    regions: RegionSummary,
    zone_of: Callable[[int], str],
) -> str:
    """Return where the robots were lately, their mean error, their regions and the best one.

    For example: `f2 70%, f3 21%, f1 9%, error 0.0213, 14 regions, best 12 (f2) progress 0.0041`.

    Args:
        errors: The last errors, shape `(T, A)`, at least one, in scaled units.
        zones: The zones of these decisions, of the same shape; None in a world without zones.
        zone_names: Their names.
        regions: The present leaves of some agents.
        zone_of: Says in which zone a region of the first agent lies; nothing if in none.
    """
    parts = [] if zones is None else _shares(zones, zone_names)
    n_agents = int(regions.agent[-1]) + 1
    n_regions = len(regions.agent) / n_agents
    plural = "" if n_regions == 1 else "s"
    parts += [f"error {errors.mean():.3g}", f"{n_regions:.4g} region{plural}"]
    own = regions.progress[regions.agent == 0]
    best = int(regions.region[own.argmax()])  # the first agent's regions come first
    zone = zone_of(best)
    place = f" ({zone})" if zone else ""
    parts.append(f"best {best}{place} progress {own.max().item() + 0.0:.3g}")  # no -0
    return ", ".join(parts)


def _shares(zones: NDArray[np.integer[Any]], zone_names: Sequence[str]) -> list[str]:
    """Return the shares of the zones that robots were in, the largest first."""
    shares = np.bincount(zones.ravel(), minlength=len(zone_names)) / zones.size
    order = np.argsort(-shares, kind="stable")
    return [f"{zone_names[zone]} {shares[zone]:.0%}" for zone in order if shares[zone]]
