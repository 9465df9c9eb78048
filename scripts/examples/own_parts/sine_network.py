"""A network of one's own: one hidden layer of sine waves."""

from dataclasses import dataclass

from torch import Tensor, nn


class Sines(nn.Module):
    """One hidden layer of sine waves."""

    def __init__(self, n_inputs: int, n_outputs: int, width: int) -> None:
        super().__init__()
        self.waves, self.mix = nn.Linear(n_inputs, width), nn.Linear(width, n_outputs)

    def forward(self, situations: Tensor) -> Tensor:
        """Return the outcomes `(n, n_outputs)` of situations `(n, n_inputs)`."""
        outcomes: Tensor = self.mix(self.waves(situations).sin())
        return outcomes


@dataclass(frozen=True)
class SineNetwork:
    """Makes a network for each region. Its fields are options: `--experts.width 16`."""

    width: int = 24
    """How many waves."""

    def __call__(self, n_inputs: int, n_outputs: int) -> nn.Module:
        """Return a new network, from numbers `(n, n_inputs)` to numbers `(n, n_outputs)`."""
        return Sines(n_inputs, n_outputs, self.width)
