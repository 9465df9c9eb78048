"""What a user may bring to the command."""

from dataclasses import dataclass

from torch import nn


@dataclass(frozen=True)
class Wide:
    """Makes a network."""

    width: int = 8
    """Units of the hidden layer."""

    def __call__(self, n_inputs: int, n_outputs: int) -> nn.Module:
        """Return a network with one hidden layer."""
        return nn.Sequential(
            nn.Linear(n_inputs, self.width), nn.Tanh(), nn.Linear(self.width, n_outputs)
        )
