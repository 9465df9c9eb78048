"""The best cut of a full region's examples.

Shapes: `R` nodes, `L` rows of leaves (see `examples`), `F` full regions that split at the same
decision, one an agent at most.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_iac.internal.scaling import UNIT_STEP

TIE = 1e-12
"""Gains that differ relatively by less are a tie, so that rounding does not decide."""


@dataclass(frozen=True)
class Cut:
    """Where to cut some full regions in two; at most the value goes left, above it right.

    Attributes:
        found: Shape `(F,)`, bool, whether any cut was admissible; the rest is undefined if not.
        dimension: Shape `(F,)`, which dimension of the situation.
        value: Shape `(F,)`, float32, in the unit cube.
    """

    found: Tensor
    dimension: Tensor
    value: Tensor


def best_cut(situations: Tensor, outcomes: Tensor, balance: float) -> Cut:
    """Return, for each full region, the cut that leaves the least outcome variance (C2).

    Of all dimensions and all cuts midway between two consecutive distinct values, the one with the
    least sum of both sides' squared deviations of the outcome from its mean, summed over outcome
    dimensions. Ties go to the lower dimension, then to the lower cut.

    Args:
        situations: Shape `(F, N, D)`, in the unit cube.
        outcomes: Shape `(F, N, K)`, in scaled units.
        balance: Smallest share of the examples that a child may keep, in [0, 0.5].

    Raises:
        ValueError: `balance` is outside [0, 0.5].

    Example:
        The outcome jumps between the second example and the third:

        >>> situations = torch.tensor([[[0.0], [0.25], [0.75], [1.0]]])
        >>> outcomes = torch.tensor([[[0.1], [0.1], [0.9], [0.9]]])
        >>> best_cut(situations, outcomes, balance=0.15).value
        tensor([0.5000])

    Source: Oudeyer and Kaplan (2004), section 2.1, criterion C2, which does not say where cuts may
    be nor how ties are decided.
    """
    if not 0 <= balance <= 0.5:
        raise ValueError(f"balance must lie in [0, 0.5], got {balance}")
    n_examples = situations.shape[1]
    values, order = _sorted(situations.mT)  # (F, D, N)
    gains = _gains(order, outcomes.mT)  # (F, D, N-1)
    n_left = torch.arange(1, n_examples, device=situations.device)
    smaller = torch.minimum(n_left, n_examples - n_left).double()
    admissible = values[..., :-1] < values[..., 1:]
    admissible &= smaller / n_examples >= balance
    gains = gains.masked_fill_(~admissible, -math.inf).flatten(1)  # (F, D * (N-1))
    best = gains.amax(dim=1, keepdim=True)
    first_tied = (gains >= best * (1 - TIE)).to(torch.int8).argmax(dim=1)
    dimension = first_tied // (n_examples - 1)
    index = (first_tied % (n_examples - 1))[:, None]
    values = values.gather(1, dimension[:, None, None].expand(-1, 1, n_examples))[:, 0]
    value = (values.gather(1, index) + values.gather(1, index + 1)) / 2
    return Cut(best.squeeze(1) > -math.inf, dimension, value.squeeze(1))


def _sorted(values: Tensor) -> tuple[Tensor, Tensor]:
    """Return sorted values `(..., n)` and the sorting indices; equal values in any order."""
    if values.device.type == "cpu":  # where numpy is six times as fast
        order = torch.from_numpy(values.numpy().argsort(axis=-1))
    else:
        order = values.argsort(dim=-1)
    return values.gather(-1, order), order


def _gains(order: Tensor, outcomes: Tensor) -> Tensor:
    """Return by how much each cut lowers the sum of squared deviations, shape `(F, D, N-1)`.

    With `S` a sum of outcomes and `n` how many they are, the decrease is
    (n S_left - n_left S)^2 / (n n_left n_right), which needs no sum of squares. In
    steps of `UNIT_STEP` the outcomes are whole numbers, so the bracket is exact, and cuts that
    divide the examples in the same way have the same gain, bit for bit. The constant 1 / n is left
    out.

    Args:
        order: Shape `(F, D, N)`, the examples from low to high along each dimension.
        outcomes: Shape `(F, K, N)`.
    """
    n_examples = outcomes.shape[2]
    whole = (outcomes.double() / UNIT_STEP).round()
    n_left = torch.arange(1, n_examples, device=outcomes.device, dtype=torch.float64)
    gains = torch.zeros((), dtype=torch.float64, device=outcomes.device)
    for k in range(outcomes.shape[1]):
        column = whole[:, k, None].expand(order.shape)
        sums = column.gather(2, order).cumsum(dim=2)  # (F, D, N)
        gains = gains + (n_examples * sums[..., :-1] - n_left * sums[..., -1:]).square_()
    return gains.div_(n_left * (n_examples - n_left))
