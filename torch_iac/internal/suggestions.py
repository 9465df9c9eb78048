"""What was perhaps meant by a mistyped name; it imports nothing heavy."""

from collections.abc import Iterable
from difflib import get_close_matches

N_SUGGESTIONS, LIKENESS = 3, 0.75
"""How many names are suggested at most, and how like (1 is equal) what was typed they are."""


def suggested(
    word: str,
    known: Iterable[str],
    n_most: int = N_SUGGESTIONS,
    likeness: float = LIKENESS,
    prefix: str = "",
) -> str:
    """Return `; perhaps you meant ...` if a word is like some that are known, else nothing.

    Args:
        word: What was typed.
        known: What could have been meant.
        n_most: How many names are suggested at most.
        likeness: How like the word they are at least, in [0, 1].
        prefix: Stands before each name in the answer.
    """
    near = get_close_matches(word, list(known), n_most, likeness)
    return f"; perhaps you meant {', '.join(prefix + name for name in near)}" if near else ""


def suggested_one(word: str, known: Iterable[str]) -> str:
    """Return the same for the likest of a few names, which may be less like the word."""
    return suggested(word, known, n_most=1, likeness=0.6)
