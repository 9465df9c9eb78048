"""Whole numbers in a config: how small and how large they may be."""

MOST = 10**12
"""Beyond any use, and far below where 64 bits end: sums and products of a few still fit."""


def check_count(name: str, value: int, least: int = 1) -> None:
    """Refuse a number of things that is too small or too large.

    Raises:
        ValueError: `value` is outside [`least`, `MOST`].
    """
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    if value > MOST:
        raise ValueError(f"{name} must be at most {MOST:,}, got {_shown(value)}")


def _shown(value: int) -> str:
    digits = str(value)
    return digits if len(digits) <= 40 else f"a number of {len(digits)} digits"
