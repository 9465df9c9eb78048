"""Numbers as others give them: arrays of any kind, lists, tensors."""

from typing import Any

import numpy as np
import torch
from torch import Tensor


def own_tensor(values: Any, what: str, device: torch.device | None = None) -> Tensor:
    """Return numbers as a float32 tensor that shares no memory with them.

    Args:
        values: An array in any byte order and layout, a list, or a tensor; of any shape.
        what: What they are, such as "sensors".
        device: Where the tensor will be; where they are if not given.

    Returns:
        Of the same shape.

    Raises:
        ValueError: They are not real numbers, or a list has rows of several lengths.
    """
    if isinstance(values, Tensor):
        if values.is_complex():
            raise ValueError(f"{what} must be real numbers, got {values.dtype}")
        known = values.detach() if values.requires_grad else values
        return known.to(device, torch.float32, copy=True)
    try:
        array = np.array(values, order="C")
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be rows of real numbers, got {values!r:.60}") from None
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{what} must be real numbers, got {array.dtype}")
    if array.dtype != np.float32:  # torch lacks some kinds; float64 holds what float32 can
        array = array.astype(np.float64)
    return torch.from_numpy(array).to(device, torch.float32)
