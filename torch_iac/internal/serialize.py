"""Nested state as flat named tensors and JSON, so that reading it back can run no code.

What is packed: dicts with names for keys, lists and tuples, of tensors, arrays, numbers, text and
None. In the JSON a dict, a list, a tuple or an array is a dict with its kind as the only name:
`{"tuple": [1, {"array": "world/1"}]}` is `(1, array)` with the array among the tensors.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

ROOT = "state"
"""Name of the whole state in errors."""

LARGEST_NUMBER = 8
"""In bytes; files of tensors hold no longer numbers."""


def pack(value: Any) -> tuple[dict[str, Tensor], Any]:
    """Return the tensors of a nested state by name, and the JSON that says where they belong.

    Shapes are kept. Tensors that are on the CPU already are not copied, unless they share their
    memory.

    Raises:
        TypeError: A part can be in neither.
        ValueError: A number is not finite, or two tensors would have one name.
    """
    tensors: dict[str, Tensor] = {}
    content = _packed(value, "", tensors)
    seen = set()
    for name, tensor in tensors.items():
        memory = tensor.untyped_storage().data_ptr()
        if memory in seen:
            tensors[name] = tensor.clone()
        seen.add(memory)
    return tensors, content


def unpack(tensors: Mapping[str, Tensor], content: Any) -> Any:
    """Return the nested state that `pack` packed; its tensors are on the CPU.

    Raises:
        ValueError: The JSON is not what `pack` writes, or asks for tensors that are not there.
    """
    if content is None or isinstance(content, (bool, int, float, str)):
        return content
    if isinstance(content, dict) and len(content) == 1:
        ((kind, packed),) = content.items()
        if kind in _OF_PARTS and isinstance(packed, list):
            return _OF_PARTS[kind](unpack(tensors, part) for part in packed)
        if kind == "dict" and isinstance(packed, dict):
            return {key: unpack(tensors, part) for key, part in packed.items()}
        if kind in _OF_TENSOR and isinstance(packed, str) and packed in tensors:
            return _OF_TENSOR[kind](tensors[packed])
    raise ValueError(f"a state must be made of known kinds, got {str(content)[:80]}")


_OF_PARTS: dict[str, Callable[..., Any]] = {"list": list, "tuple": tuple}
_OF_TENSOR: dict[str, Callable[[Tensor], Any]] = {
    "tensor": lambda tensor: tensor,
    "array": lambda tensor: tensor.numpy(),
    "scalar": lambda tensor: tensor.numpy()[()],
}


def _packed(value: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if type(value) is float:  # a numpy number may be a float too
        if not math.isfinite(value):
            raise ValueError(f"{name or ROOT} must be finite, got {value}")
        return value
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{name or ROOT} must have names for keys, got {key!r}")
        return {"dict": {key: _packed(v, _join(name, key), tensors) for key, v in value.items()}}
    if type(value) in (list, tuple):
        parts = [_packed(part, _join(name, i), tensors) for i, part in enumerate(value)]
        return {type(value).__name__: parts}
    name = name or ROOT
    if name in tensors:
        raise ValueError(f"{name} must name one tensor, got two")
    kind, tensors[name] = _as_tensor(value, name)
    return {kind: name}


def _join(name: str, key: str | int) -> str:
    return f"{name}/{key}" if name else str(key)


def _as_tensor(value: Any, name: str) -> tuple[str, Tensor]:
    if isinstance(value, Tensor):
        return "tensor", value.detach().cpu().contiguous()
    if not isinstance(value, (np.ndarray, np.generic)):
        raise TypeError(f"{name} must be made of numbers to be saved, got a {type(value).__name__}")
    if value.dtype.kind not in "biuf" or value.dtype.itemsize > LARGEST_NUMBER:
        raise TypeError(f"{name} must hold plain numbers to be saved, got {value.dtype}")
    kind = "array" if isinstance(value, np.ndarray) else "scalar"
    return kind, torch.from_numpy(np.array(value, value.dtype.newbyteorder("="), order="C"))
