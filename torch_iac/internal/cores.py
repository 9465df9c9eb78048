"""How many processor cores there are."""

import os


def n_cores() -> int:
    """Return how many cores this process may use, or how many there are where that is unknown."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
