"""The kind of processor, on which the rounding of numbers may depend."""

import platform
from pathlib import Path

import torch


def processor() -> dict[str, str]:
    """Return the kind of the processor: its architecture, its model, what torch uses of it."""
    return {
        "architecture": platform.machine(),
        "model": _model(),
        "capability": torch.backends.cpu.get_cpu_capability(),
    }


def rounds_alike(one: object, other: dict[str, str], is_exact: bool) -> bool:
    """Return whether a run is the same to the bit on two processors.

    Args:
        one: What `processor` returned on the first, as `config.json` holds it; None if it was not
            written down.
        other: What it returned on the second.
        is_exact: Whether the run is the same on all of one architecture.
    """
    if is_exact and isinstance(one, dict):
        return one.get("architecture") == other["architecture"]
    return one == other


def described(one: object) -> str:
    """Return what `processor` returned, in words."""
    return ", ".join(map(str, one.values())) if isinstance(one, dict) else "not written down"


def _model() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    names = (line.partition(": ")[2] for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or "unknown")
