"""Parts of a config as JSON, and back: the library's own by their names, a user's by module:Name.

A dataclass is `{"kind": "MLPExperts", "hidden": [32, 32], ...}`, with all its fields; a class or a
function is `{"object": "my_module:MyNet"}`. Nothing is imported, and so no code of a user's runs,
until `from_json` is asked for the object.
"""

import re
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, get_type_hints

from typeguard import CollectionCheckStrategy, TypeCheckError, check_type

from torch_iac.internal.validation import plain

KIND, OBJECT, LOST = "kind", "object", "lost"
"""Keys: the class of an object; a class or function itself; what JSON lacks, in words."""


def to_json(value: Any, kinds: Mapping[str, type]) -> Any:
    """Return a value as JSON can hold it; `from_json` refuses what this does not hold in full.

    Args:
        value: A number, also of numpy or PyTorch, a text, None, a list, a tuple or a mapping by
            name of values, a dataclass with such fields, an object without any attributes, a class
            or a function.
        kinds: The classes that are named without a module, by name.
    """
    value = plain(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Mapping):
        return {name: to_json(part, kinds) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json(part, kinds) for part in value]
    if isinstance(value, type) or hasattr(value, "__qualname__"):
        return {OBJECT: name_of(value)}
    kind = type(value)
    name = kind.__name__ if kinds.get(kind.__name__) is kind else name_of(kind)
    if not is_dataclass(value):
        lost = _lost(value)
        return {KIND: name, LOST: lost} if lost else {KIND: name}
    names = [field.name for field in fields(value) if field.init]
    return {KIND: name, **{field: to_json(getattr(value, field), kinds) for field in names}}


def from_json(content: Any, kinds: Mapping[str, type], where: str = "value") -> Any:
    """Return the value of which `to_json` made JSON; lists become tuples.

    Args:
        content: The JSON.
        kinds: As for `to_json`.
        where: The value's name in errors.

    Raises:
        ValueError: A kind or an object cannot be found, has other fields or refuses a value; the
            message names it.
    """
    if isinstance(content, list):
        return tuple(from_json(part, kinds, f"{where}.{i}") for i, part in enumerate(content))
    if not isinstance(content, Mapping):
        return content
    if content.keys() == {OBJECT}:
        return import_object(content[OBJECT], where)
    parts = {
        name: from_json(part, kinds, f"{where}.{name}")
        for name, part in content.items()
        if name != KIND
    }
    return _made(content[KIND], parts, kinds, where) if KIND in content else parts


def build(kind: type, values: Mapping[str, Any], where: str) -> Any:
    """Return a dataclass made of values for fields of it, whose types are checked.

    Raises:
        ValueError: There is no such field, or it takes no such value; the message names it.
    """
    known = {field.name for field in fields(kind) if field.init} if is_dataclass(kind) else set()
    for name in values:
        if name not in known:
            among = ", ".join(sorted(known)) or "none"
            raise ValueError(f"{where} must have fields among {among}, got {name}")
    hints = _hints(kind)
    for name, value in values.items():
        _check(value, hints.get(name, Any), f"{where}.{name}")
    try:
        return kind(**values)
    except TypeError as error:  # such as a field that is missing
        raise ValueError(f"{where} must be made of its fields: {error}") from None


def make_importable(folder: Path | str) -> None:
    """Let modules be imported from a folder too, after all other places."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def name_of(value: Any) -> str:
    """Return the name `module:Name` by which a class or a function is imported."""
    name, module = getattr(value, "__qualname__", repr(value)), value.__module__
    if module == "__main__":  # a script is imported by the name of its file
        module = Path(getattr(sys.modules["__main__"], "__file__", module)).stem
    return f"{module}:{name}"


def import_object(name: Any, where: str = "value") -> Any:
    """Return the class or the function that is called `module:Name`, once its module is imported.

    Args:
        name: `module:Name`.
        where: Its name in errors.

    Raises:
        ValueError: It cannot be imported.
    """
    module, colon, qualified = name.partition(":") if isinstance(name, str) else ("", "", "")
    if not (module and colon and qualified):
        raise ValueError(f"{where} must be written module:Name, got {name!r:.80}")
    if "<" in qualified:  # as in <lambda> or function.<locals>.Name
        raise ValueError(
            f"{where} must be a class or a function that its module names, so that it can be "
            f"imported again, got {name}; define it outside of any function"
        )
    try:
        found = import_module(module)
    except Exception as error:  # whatever the user's module does
        raise ValueError(
            f"{where} must be importable, got {name} ({type(error).__name__}: {error})"
        ) from error
    for part in qualified.split("."):
        if not hasattr(found, part):
            raise ValueError(f"{where} must be in its module, got {name}, which is not")
        found = getattr(found, part)
    return found


def _lost(value: Any) -> dict[str, str]:
    """Return what an object has that its class alone does not make again, by name, in words."""
    lost = vars(value) if hasattr(value, "__dict__") else {}
    if not lost and not _is_empty(value):
        lost = {"value": value}  # such as an array, a set or a functools.partial
    # The words are compared where a checkpoint must fit: addresses differ from run to run.
    return {name: re.sub(r" at 0x[0-9a-fA-F]+", "", repr(part)) for name, part in lost.items()}


def _is_empty(value: Any) -> bool:
    try:
        _, arguments, state = (*value.__reduce_ex__(2), None)[:3]
    except TypeError:  # such as a lock or a generator, which are made of more than Python shows
        return False
    return arguments == (type(value),) and state is None


def _made(kind: Any, parts: Mapping[str, Any], kinds: Mapping[str, type], where: str) -> Any:
    if LOST in parts:
        names = ", ".join(parts[LOST]) if isinstance(parts[LOST], Mapping) else parts[LOST]
        raise ValueError(
            f"{where} must be a dataclass for its attributes to be kept ({names}), "
            f"got {kind}, which is none"
        )
    if isinstance(kind, str) and ":" in kind:
        found = import_object(kind, where)
    elif isinstance(kind, str) and kind in kinds:
        found = kinds[kind]
    else:
        raise ValueError(f"{where} must be of a known kind ({', '.join(kinds)}), got {kind!r:.80}")
    if not isinstance(found, type):
        raise ValueError(f"{where} must be of a class, got {kind}, which is none")
    return build(found, parts, where)


def _hints(kind: type) -> dict[str, Any]:
    try:
        return get_type_hints(kind)
    except Exception:  # a user's annotations may name what is not there at run time
        return {}


def _check(value: Any, hint: Any, where: str) -> None:
    try:
        check_type(value, hint, collection_check_strategy=CollectionCheckStrategy.ALL_ITEMS)
    except TypeCheckError as error:
        raise ValueError(f"{where} must be of its type, got {value!r:.80} ({error})") from None
