"""The meta-predictor MP: a network that learns what error to expect in a situation.

Shapes: `B` bins into which a network's inputs divide each dimension of a situation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_iac.experts.mlp import MLP
from torch_iac.experts.stacked_networks import StackedNetworks, Training, pick
from torch_iac.internal import kernels
from torch_iac.internal.losses import SMALL_ERROR, Loss, gamma_loss, squared_error
from torch_iac.internal.randomness import RandomStream
from torch_iac.internal.state import Stateful
from torch_iac.internal.validation import check_count

META_STREAM = 2
"""Which of an agent's random streams the decisions that MP learns from are drawn from."""


@dataclass(frozen=True, kw_only=True)
class RecentTraining(Training):
    """How a network of the agent learns from its most recent decisions.

    Raises:
        ValueError: A number is out of its range; the message names it, the rule and the value.
    """

    hidden: tuple[int, ...] = (32, 32)
    """Units of each hidden layer."""
    memory: int = 1000
    """How many of the most recent decisions it learns from."""
    bins: int = 1
    """Into how many equal bins of [0, 1] its inputs divide each dimension of the situation: one
    input a bin, how far the value fills it (`filled_bins`). With 1 they are the situation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        MLP(self.hidden)
        for name in ("memory", "bins"):
            check_count(name, getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class MetaPredictor(RecentTraining):
    """MP, one multi-layer perceptron for each agent, from a situation to the expected error.

    It learns online, from the most recent situations and errors only, since errors age. Its output
    is the logarithm of the expected error, so it is never negative. Its loss is

        error / expected + log(expected)

    which is least where the expectation is the mean error, and weighs errors relatively: a small
    error is learnt as precisely as a large one (the loss of a gamma-distributed error).

    Errors can be fifty times as large on one side of a sharp edge as on the other. A network of
    the situation alone smooths such an edge; with each dimension divided into `bins` it needs few
    weights for an edge, so that few hidden units are enough, which is more accurate.

    Source: Oudeyer and Kaplan (2004), section 2.1, which does not say what MP is.
    """

    hidden: tuple[int, ...] = (8,)
    """Units of each hidden layer; few, since rare situations leave few errors to learn from."""
    bins: int = 16
    """Into how many equal bins its inputs divide each dimension, so that it can learn edges."""
    learning_rate: float = 0.001
    """Step size of the optimiser."""
    minibatches: int = 1
    """How many steps of the optimiser a decision."""
    minibatch_size: int = 128
    """How many decisions each step looks at, drawn with replacement; many, since errors scatter."""
    memory: int = 600
    """How many of the most recent decisions it learns from."""

    def start(
        self, situation_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "ErrorExpectation":
        """Return the meta-predictors of a population."""
        return ErrorExpectation(RecentNetworks(self, gamma_loss, situation_dim, seeds, device))


@dataclass(frozen=True, kw_only=True)
class ImprovementPredictor(RecentTraining):
    """A network for each agent, from a situation to how much learning there lowers the error.

    Its loss is the squared error.

    Source: Schmidhuber (1991); what the network is, is this library's choice.
    """

    def start(
        self, situation_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "RecentNetworks":
        """Return the networks of a population."""
        return RecentNetworks(self, squared_error, situation_dim, seeds, device)


class ErrorExpectation(Stateful):
    """The meta-predictors of a population.

    Args:
        networks: From situations to the logarithm of the error.
    """

    saved = ("_networks",)

    def __init__(self, networks: "RecentNetworks") -> None:
        self._networks = networks

    def expect(self, situations: Tensor) -> Tensor:
        """Return the expected error in situations `(A, C, D)`, shape `(A, C)`, in scaled units."""
        return kernels.exp(self._networks.predict(situations)).sub_(SMALL_ERROR).clamp_(0.0, 1.0)

    def learn(self, situations: Tensor, errors: Tensor, step: int) -> Tensor:
        """Learn from one situation `(A, D)` and error `(A,)` each; return the losses `(A,)`.

        Situations are in the unit cube, errors in scaled units; `step` is the decision's number.
        """
        return self._networks.learn(situations, errors, step)


class RecentNetworks(Stateful):
    """One network for each agent, from a situation to a number, trained on the most recent pairs.

    Args:
        training: How it learns.
        loss: The loss, averaged over a minibatch.
        situation_dim: D.
        seeds: One for each agent.
        device: Where it learns.
    """

    saved = ("_networks", "_situations", "_targets")

    def __init__(
        self,
        training: RecentTraining,
        loss: Loss,
        situation_dim: int,
        seeds: Sequence[int],
        device: torch.device,
    ) -> None:
        self._training, self._loss = training, loss
        self._agents = torch.arange(len(seeds), device=device)
        self._bins = torch.arange(training.bins, device=device)
        n_inputs = situation_dim * training.bins
        self._networks = StackedNetworks(MLP(training.hidden), n_inputs, 1, training, device)
        self._networks.reserve(len(seeds))
        self._networks.start(self._agents, seeds)
        n_picks = training.minibatches * training.minibatch_size
        self._picks = RandomStream(seeds, n_picks, META_STREAM, device)
        self._situations = torch.zeros(len(seeds), situation_dim, training.memory, device=device)
        self._targets = torch.zeros(len(seeds), 1, training.memory, device=device)

    def predict(self, situations: Tensor) -> Tensor:
        """Return the networks' outputs for situations `(A, C, D)`, shape `(A, C)`."""
        inputs = filled_bins(situations, self._bins)
        return self._networks.predict(self._agents, inputs)[..., 0]

    def learn(self, situations: Tensor, targets: Tensor, step: int) -> Tensor:
        """Store a situation `(A, D)` and its target `(A,)`, learn, return the losses `(A,)`.

        Situations are in the unit cube; `step` is the decision's number.
        """
        place = step % self._training.memory
        self._situations[:, :, place] = situations
        self._targets[:, 0, place] = targets.float()
        n_pairs = min(step + 1, self._training.memory)
        picks = (self._picks.at(step) * n_pairs).long()
        inputs = filled_bins(pick(self._situations, picks), self._bins)
        outputs = pick(self._targets, picks)
        size = self._training.minibatch_size
        return self._networks.train(self._agents, inputs, outputs, size, self._loss)


def filled_bins(situations: Tensor, bins: Tensor) -> Tensor:
    """Return how far situations `(..., D)` fill bins `(B,)`: `(..., D * B)`, from 0 to 1.

    The bins are 0, 1, ..., B - 1, from 0 to 1 in each dimension; those below a value are full, its
    own is filled as far as it lies in it, those above are empty.

    Source: Gorishniy, Rubachev and Babenko (2022), On Embeddings for Numerical Features in Tabular
    Deep Learning, the piecewise linear encoding.
    """
    return (situations[..., None] * len(bins)).sub(bins).clamp_(0.0, 1.0).flatten(-2)
