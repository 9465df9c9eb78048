"""Raw units to the unit interval and back."""

from collections.abc import Sequence
from dataclasses import astuple

import torch
from torch import Tensor

from torch_iac.space import Dimension

UNIT_STEP = 2.0**-23
"""Scaled values are multiples of this. So every one of them, every midpoint of two of them and
every difference is exact in float32, and sums are exact in float64, in whatever order."""

OUTSIDE_TOLERANCE = 1e-3
"""How far outside its bounds a sensor may read, as a share of its range; then it is clipped."""


class Scale:
    """Raw units to the unit interval and back, for a row of dimensions.

    Args:
        dimensions: The row.
        device: Where values will be scaled.

    Attributes:
        dimensions: The row.
    """

    def __init__(self, dimensions: Sequence[Dimension], device: torch.device) -> None:
        self.dimensions = tuple(dimensions)
        bounds = torch.tensor([(d.low, d.high) for d in dimensions], dtype=torch.float64)
        low, high = bounds.unbind(1)
        span, slack = high - low, OUTSIDE_TOLERANCE * (high - low)
        self._low = low.to(device, torch.float32)
        self._span = span.to(device, torch.float32)
        self._steps = (1 / UNIT_STEP / span).to(device, torch.float32)  # in one raw unit
        self._first_step = (-low / UNIT_STEP / span).to(device, torch.float32)
        self._least = (low - slack).to(device, torch.float32)
        self._most = (high + slack).to(device, torch.float32)

    def to_unit(self, raw: Tensor) -> Tensor:
        """Return raw values `(..., n)` scaled to [0, 1], clipped, in multiples of `UNIT_STEP`."""
        # No `addcmul`: some processors round it once, others twice.
        steps = raw * self._steps + self._first_step
        return steps.clamp_(0.0, 1 / UNIT_STEP).round_().mul_(UNIT_STEP)

    def to_raw(self, unit: Tensor) -> Tensor:
        """Return scaled values `(..., n)` in raw units."""
        return unit * self._span + self._low

    def contains(self, raw: Tensor) -> bool:
        """Return whether all values `(..., n)` are numbers in their bounds, rounding forgiven."""
        return torch.equal(raw.clamp(self._least, self._most), raw)

    def outside(self, raw: Tensor) -> Tensor:
        """Return which values `(..., n)` are outside."""
        return raw.clamp(self._least, self._most) != raw  # NaN differs from itself

    def check(self, raw: Tensor, whose: str) -> None:
        """Refuse values `(n_rows, n)` that are outside their bounds.

        Args:
            raw: The values.
            whose: What a row is, such as "agent".

        Raises:
            ValueError: There are some; the message names the first.
        """
        if self.contains(raw):
            return
        row, column = self.outside(raw).nonzero()[0].tolist()
        name, low, high = astuple(self.dimensions[column])
        value = raw[row, column].item()
        raise ValueError(
            f"{name} must lie in [{low:g}, {high:g}], got {value:g} from {whose} {row}"
        )
