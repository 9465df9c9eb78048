"""Limits of whole numbers in a config."""

MAX_COUNT = 10**12
"""Keeps products within int64."""


def check_count(name: str, value: int, least: int = 1) -> None:
    """Refuse a number of things that is too small or too large.

    Raises:
        ValueError: `value` is outside [`least`, `MAX_COUNT`].
    """
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    if value > MAX_COUNT:
        raise ValueError(f"{name} must be at most {MAX_COUNT:,}, got {_shown(value)}")


def _shown(value: int) -> str:
    digits = str(value)
    return digits if len(digits) <= 40 else f"a number of {len(digits)} digits"
