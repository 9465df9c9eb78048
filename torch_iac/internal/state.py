"""The state of an object: all that its future depends on, as flat named tensors on the CPU."""

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

State = dict[str, Tensor]
"""Tensors by name; names of nested parts have a slash, as in `tree/parent`."""


@runtime_checkable
class Resumable(Protocol):
    """An object that can be saved, and goes on from its state bit for bit."""

    def state(self) -> State:
        """Return a copy of all that the future depends on."""

    def load_state(self, state: State) -> None:
        """Go on from what `state` returned; the object was made with the same arguments."""


class Stateful:
    """Saves and loads the attributes that its class names; a mixin.

    Such an attribute is a tensor, a whole number that is not negative, anything `Resumable`, a
    mapping of these by name, or None, which has no state. A leading underscore is left out of its
    name.

    Attributes:
        saved: The attributes that are kept as they are.
        tables: The columns that grow, each a tensor or a mapping of tensors by name, under the
            attribute that says how many of their rows are in use. Only these rows are kept.
    """

    saved: ClassVar[tuple[str, ...]] = ()
    tables: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def state(self) -> State:
        """Return a copy of all that the future depends on.

        Raises:
            TypeError: A part cannot be saved.
        """
        state: State = {}
        for name in (*self.tables, *self.saved):
            state |= _collect(name.lstrip("_"), getattr(self, name))
        for count, columns in self.tables.items():
            n_rows = getattr(self, count)
            for name in columns:
                state |= _collect(name.lstrip("_"), _first_rows(getattr(self, name), n_rows))
        return state

    def load_state(self, state: State) -> None:
        """Go on from what `state` returned; the object was made with the same arguments.

        Raises:
            ValueError: A tensor is missing, has another type or shape, or is not known. The object
                is then of no use any more.
        """
        rest = dict(state)
        for name in (*self.tables, *self.saved):
            setattr(self, name, _restored(name.lstrip("_"), getattr(self, name), rest))
        for count, columns in self.tables.items():
            n_rows = getattr(self, count)
            for name in columns:
                setattr(
                    self, name, _restored_rows(name.lstrip("_"), getattr(self, name), n_rows, rest)
                )
        for name in rest:
            raise ValueError(f"{name} must not be in the state, which has no place for it")


def _collect(name: str, part: Any) -> State:
    """Return the state of one attribute, under its name."""
    if part is None:
        return {}
    if isinstance(part, Tensor):
        return {name: part.detach().to("cpu", copy=True).contiguous()}
    if isinstance(part, int):
        return {name: torch.tensor(part)}
    if isinstance(part, Mapping):
        parts = (_collect(f"{name}/{key}", value) for key, value in part.items())
        return {key: tensor for state in parts for key, tensor in state.items()}
    if isinstance(part, Resumable):
        return {f"{name}/{key}": tensor for key, tensor in part.state().items()}
    raise TypeError(
        f"{name} must have the methods state and load_state to be saved, "
        f"got {type(part).__name__} without"
    )


def _restored(name: str, part: Any, rest: State) -> Any:
    """Return the restored attribute, and remove its state from the rest."""
    if isinstance(part, Tensor):
        return _taken(name, part, rest).to(part.device, copy=True)
    if isinstance(part, int):
        number = int(_taken(name, torch.tensor(part), rest))
        if number < 0:
            raise ValueError(f"{name} must be at least 0, got {number}")
        return number
    if isinstance(part, Mapping):
        for key in sorted(part, key=len, reverse=True):  # a name may begin with another one
            _restored(f"{name}/{key}", part[key], rest)
    elif part is not None:
        names = [key for key in rest if key.startswith(f"{name}/")]
        try:
            part.load_state({key.removeprefix(f"{name}/"): rest.pop(key) for key in names})
        except ValueError as error:
            raise ValueError(f"{name}/{error}") from None
    return part


def _first_rows(column: Tensor | Mapping[str, Tensor], n_rows: int) -> Any:
    if isinstance(column, Tensor):
        return column[:n_rows]
    return {name: part[:n_rows] for name, part in column.items()}


def _restored_rows(
    name: str, column: Tensor | Mapping[str, Tensor], n_rows: int, rest: State
) -> Any:
    """Return so many restored rows of a column, and remove their state from the rest."""
    if isinstance(column, Tensor):
        wanted = column.new_empty((n_rows, *column.shape[1:]), device="meta")
        return _taken(name, wanted, rest).to(column.device, copy=True)
    parts = column.items()
    return {key: _restored_rows(f"{name}/{key}", part, n_rows, rest) for key, part in parts}


def _taken(name: str, wanted: Tensor, rest: State) -> Tensor:
    """Take a tensor from the state, of the type and the shape that is wanted."""
    if name not in rest:
        raise ValueError(f"{name} must be in the state, got none")
    tensor = rest.pop(name)
    if tensor.dtype != wanted.dtype or tensor.shape != wanted.shape:
        raise ValueError(
            f"{name} must be {wanted.dtype} of shape {tuple(wanted.shape)}, "
            f"got {tensor.dtype} of shape {tuple(tensor.shape)}"
        )
    return tensor


def reserve(column: Tensor, n_rows: int, fill: float | None = None) -> Tensor:
    """Return the column itself if it has `n_rows` rows, else a copy of at least twice its length.

    Args:
        column: Shape `(capacity, ...)`.
        n_rows: How many rows are needed.
        fill: What the new rows hold. None leaves them unwritten, for columns whose rows are written
            before they are read: an operating system gives memory only to what has been written.
    """
    capacity = column.shape[0]
    if n_rows <= capacity:
        return column
    grown = column.new_empty((max(n_rows, 2 * capacity), *column.shape[1:]))
    grown[:capacity] = column
    if fill is not None:
        grown[capacity:] = fill
    return grown
