"""Multi-layer perceptrons."""

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import nn

from torch_iac.internal.validation import check_count, settle


@dataclass(frozen=True)
class MLP:
    """Makes multi-layer perceptrons with ReLU.

    Raises:
        ValueError: A layer has no units or too many.
    """

    hidden: tuple[int, ...] = (32, 32)
    """Units of each hidden layer."""

    def __post_init__(self) -> None:
        settle(self)
        if any(units < 1 for units in self.hidden):
            raise ValueError(f"hidden must be at least 1 unit a layer, got {self.hidden}")
        for units in self.hidden:
            check_count("hidden", units)

    def __call__(
        self, n_inputs: int, n_outputs: int, generator: torch.Generator | None = None
    ) -> nn.Module:
        """Return a new network, from numbers `(n, n_inputs)` to numbers `(n, n_outputs)`.

        Args:
            n_inputs: Its inputs.
            n_outputs: Its outputs.
            generator: What its weights are drawn from; torch's own if not given.
        """
        layers: list[nn.Module] = []
        for n_in, n_out in self.sizes(n_inputs, n_outputs):
            layers += [_linear_layer(n_in, n_out, generator), nn.ReLU()]
        return nn.Sequential(*layers[:-1])

    def sizes(self, n_inputs: int, n_outputs: int) -> list[tuple[int, int]]:
        """Return the numbers of inputs and outputs of each layer."""
        return list(pairwise((n_inputs, *self.hidden, n_outputs)))


def _linear_layer(n_inputs: int, n_outputs: int, generator: torch.Generator | None) -> nn.Linear:
    """Return a linear layer with torch's usual initial weights, the same on every processor.

    They are uniform within 1 / sqrt(n_inputs), from the same random numbers as `nn.Linear`'s own,
    whose `uniform_` rounds as the processor does.
    """
    layer: nn.Linear = nn.utils.skip_init(nn.Linear, n_inputs, n_outputs)  # type: ignore[no-untyped-call]
    with torch.no_grad():
        for weights in (layer.weight, layer.bias):
            weights.copy_(
                (torch.rand(weights.shape, generator=generator) * 2 - 1) * (1 / math.sqrt(n_inputs))
            )
    return layer
