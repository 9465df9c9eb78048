"""Raw units to the unit interval and back."""

from collections.abc import Sequence

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

    def of_drawn(self, drawn: Tensor) -> Tensor:
        """Return uniform numbers `(..., n)` in [0, 1), multiples of `UNIT_STEP`, as scaled ones."""
        return drawn

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
        of, got = self._first(self.outside(raw), raw, whose)
        raise ValueError(f"{of.name} must lie in [{of.low:g}, {of.high:g}], {got}")

    def _first(self, wrong: Tensor, raw: Tensor, whose: str) -> tuple[Dimension, str]:
        """Return the dimension of the first wrong value `(n_rows, n)`, and what was got."""
        row, column = wrong.nonzero()[0].tolist()
        return self.dimensions[column], f"got {raw[row, column].item():g} from {whose} {row}"


class CountedScale(Scale):
    """A scale for dimensions at least one of which has but some values.

    Args:
        dimensions: The row.
        device: Where values will be scaled.
    """

    def __init__(self, dimensions: Sequence[Dimension], device: torch.device) -> None:
        super().__init__(dimensions, device)
        n_values = torch.tensor([float(of.n_values or 0) for of in dimensions], device=device)
        self._is_counted, self._n_values = n_values > 0, n_values
        self._n_gaps = (n_values - 1).clamp_(min=1)
        self._gap = self._span / self._n_gaps

    def of_drawn(self, drawn: Tensor) -> Tensor:
        """Return uniform numbers `(..., n)` in [0, 1) as scaled values, each equally likely."""
        places = (drawn * self._n_values).floor_()
        return torch.where(self._is_counted, self._unit_at(places), drawn)

    def to_unit(self, raw: Tensor) -> Tensor:
        """Return raw values `(..., n)` scaled to [0, 1]; of counted ones the nearest there is."""
        places = ((raw - self._low) / self._gap).round_()
        unit = self._unit_at(places).clamp_(0.0, 1.0)
        return torch.where(self._is_counted, unit, super().to_unit(raw))

    def to_raw(self, unit: Tensor) -> Tensor:
        """Return scaled values `(..., n)` in raw units; of counted ones the nearest there is."""
        places = (unit * self._n_gaps).round_()
        return torch.where(self._is_counted, self._raw_at(places), super().to_raw(unit))

    def check(self, raw: Tensor, whose: str) -> None:
        """Refuse values `(n_rows, n)` that are outside their bounds or between two that there are.

        Args:
            raw: The values.
            whose: What a row is, such as "agent".

        Raises:
            ValueError: There are some; the message names the first.
        """
        super().check(raw, whose)
        off = (raw - self.to_raw(self.to_unit(raw))).abs_() > OUTSIDE_TOLERANCE * self._gap
        off &= self._is_counted
        if off.any():
            of, got = self._first(off, raw, whose)
            raise ValueError(
                f"{of.name} must be one of {of.n_values} values from {of.low:g} to {of.high:g}, "
                f"{got}"
            )

    def _unit_at(self, places: Tensor) -> Tensor:
        """Return values by their places, counted from 0, as multiples of `UNIT_STEP`."""
        return (places / self._n_gaps / UNIT_STEP).round_().mul_(UNIT_STEP)

    def _raw_at(self, places: Tensor) -> Tensor:
        """Return values by their places, counted from 0, in raw units."""
        return self._low + places * self._gap


def action_scale(dimensions: Sequence[Dimension], device: torch.device) -> Scale:
    """Return the scale of a row of actions; a plain one, which is faster, if any number will do."""
    is_counted = any(of.n_values is not None for of in dimensions)
    return CountedScale(dimensions, device) if is_counted else Scale(dimensions, device)
