"""What a number, a list or a text that somebody gives must be.

Numbers of numpy and of PyTorch are taken for the numbers that they are, and become Python's own:
files hold no others.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cache
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from torch_iac.internal.mappings import FrozenMapping

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MAX_COUNT = 10**12
"""Limit of whole numbers in a config; keeps products within int64."""


def check_count(name: str, value: int, least: int = 1) -> None:
    """Refuse a number of things that is too small, too large or not whole.

    Raises:
        ValueError: `value` is not whole, or outside [`least`, `MAX_COUNT`].
    """
    value = whole(name, value)
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    if value > MAX_COUNT:
        raise ValueError(f"{name} must be at most {MAX_COUNT:,}, got {_shown(value)}")


def whole(name: str, value: Any) -> int:
    """Return a whole number as Python's own.

    Raises:
        ValueError: It is none, as 2.5, 2.0, a text and True are none.
    """
    number = plain(value)
    if type(number) is not int:
        raise ValueError(f"{name} must be a whole number, got {value!r:.80}")
    return number


def real(name: str, value: Any) -> float:
    """Return a number as Python's own float; infinity and NaN are left to its range.

    Raises:
        ValueError: It is none, as a text and True are none, or is larger than any float.
    """
    number = plain(value)
    if type(number) not in (int, float):
        raise ValueError(f"{name} must be a number, got {value!r:.80}")
    try:
        return float(number)
    except OverflowError:
        raise ValueError(f"{name} must fit into a float, got {_shown(number)}") from None


def plain(value: Any) -> Any:
    """Return Python's own number for one of numpy or of PyTorch; anything else as it is."""
    try:
        return value.item()
    except (AttributeError, TypeError, ValueError, RuntimeError):  # none, or of more than one
        return value


def jsonable(name: str, value: Any) -> Any:
    """Return a value as JSON would give it back: with lists for tuples.

    Raises:
        ValueError: JSON cannot hold it; the message names the part and the rule.
    """
    value = plain(value)
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: jsonable(f"{name}.{key}", part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(f"{name}.{i}", part) for i, part in enumerate(value)]
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{name} must be finite, got {value}")
        return value
    raise ValueError(
        f"{name} must be a number, a text, true, false, null, a list or a mapping by name, "
        f"got {value!r:.80}"
    )


def settle(part: "DataclassInstance") -> None:
    """Let every field of a frozen dataclass hold what its annotation says.

    Numbers become Python's own, lists become tuples, and mappings such as cannot change.

    Raises:
        ValueError: A field holds something else; the message names it, the rule and the value.
    """
    hints = _hints(type(part))
    for name in (field.name for field in fields(part)):
        value = settled(name, getattr(part, name), hints.get(name, Any))
        object.__setattr__(part, name, value)


def settled(name: str, value: Any, hint: Any) -> Any:
    """Return a value as an annotation has it.

    Raises:
        ValueError: It is something else; the message has its name, the rule and the value.
    """
    kind, parts = get_origin(hint), get_args(hint)
    if kind is Annotated:
        return settled(name, value, parts[0])
    if kind in (Union, UnionType):
        others = [part for part in parts if part is not NoneType]
        is_given = value is not None or len(others) == len(parts)
        return settled(name, value, others[0]) if is_given and len(others) == 1 else value
    if kind is Literal:
        if not (isinstance(value, str) and value in parts):
            raise ValueError(f"{name} must be {' or '.join(map(str, parts))}, got {value!s:.80}")
        return value
    if kind in (tuple, Sequence):
        return _list(name, value, parts if kind is tuple else (*parts, ...))
    if kind is Mapping:
        return _mapping(name, value, parts[1])
    if isinstance(hint, type):
        return _OF_KIND[hint](name, value) if hint in _OF_KIND else _object(name, value, hint)
    return value


def _list(name: str, value: Any, parts: tuple[Any, ...]) -> tuple[Any, ...]:
    if isinstance(value, (str, bytes, Mapping)) or not _is_list(value):
        raise ValueError(f"{name} must be a list, got {value!r:.80}")
    if isinstance(value, range) and parts == (int, ...):
        return tuple(value)  # there may be a million
    if parts[-1:] == (...,):
        return tuple(settled(f"{name}.{i}", each, parts[0]) for i, each in enumerate(value))
    if len(value) != len(parts):
        raise ValueError(f"{name} must be {len(parts)} values, got {value!r:.80}")
    return tuple(settled(f"{name}.{i}", each, parts[i]) for i, each in enumerate(value))


def _mapping(name: str, value: Any, hint: Any) -> FrozenMapping[Any]:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{name} must be a mapping by name, got {value!r:.80}")
    return FrozenMapping({key: settled(f"{name}.{key}", of, hint) for key, of in value.items()})


def _is_list(value: Any) -> bool:
    try:
        len(value), iter(value)
    except TypeError:  # such as a number, or an array that is one
        return False
    return True


def _object(name: str, value: Any, kind: type) -> Any:
    try:
        is_one = isinstance(value, kind)
    except TypeError:  # a protocol that is for type checkers only
        is_one = True
    if not is_one:
        raise ValueError(f"{name} must be of the kind {kind.__name__}, got {value!r:.80}")
    return value


def _switch(name: str, value: Any) -> bool:
    switch = plain(value)
    if not isinstance(switch, bool):
        raise ValueError(f"{name} must be True or False, got {value!r:.80}")
    return switch


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} must be a text, got {value!r:.80}")
    return str(value)


_OF_KIND = {int: whole, float: real, bool: _switch, str: _text}


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Return the fields of a class, each with its annotation."""
    try:
        return get_type_hints(kind, include_extras=True)
    except Exception:  # a user's annotations may name what is not there at run time
        return {}


def _shown(value: int) -> str:
    digits = str(value)
    return digits if len(digits) <= 40 else f"a number of {len(digits)} digits"
