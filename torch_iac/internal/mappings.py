"""Mappings in frozen dataclasses."""

from collections.abc import Iterator, Mapping
from typing import TypeVar

Value = TypeVar("Value", covariant=True)
"""What a mapping holds."""


class FrozenMapping(Mapping[str, Value]):
    """A mapping that does not change, and so can be hashed; equal to a dict of the same content.

    Args:
        content: What it holds, by name; copied.
    """

    def __init__(self, content: Mapping[str, Value]) -> None:
        self._content = dict(content)

    def __getitem__(self, name: str) -> Value:
        return self._content[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)

    def __hash__(self) -> int:
        return hash(frozenset(self._content))  # the values may be lists

    def __repr__(self) -> str:
        return repr(self._content)
