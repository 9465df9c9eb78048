"""Experts that are networks, one for each region."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor, nn

from torch_iac.experts.mlp import MLP
from torch_iac.experts.modules import Drawn, Factory
from torch_iac.experts.stacked_networks import StackedNetworks, Training, pick
from torch_iac.internal.generators import generator_of
from torch_iac.internal.losses import squared_error
from torch_iac.internal.randomness import RandomStream
from torch_iac.internal.state import Stateful
from torch_iac.internal.validation import check_count
from torch_iac.regions.examples import Examples
from torch_iac.regions.tree import Split

MINIBATCH_STREAM, LAYER_STREAM = 1, 3
"""Which of an agent's random streams the examples that networks learn from are drawn from, and
which one its random layers draw from, such as dropout."""


@dataclass(frozen=True, kw_only=True)
class NetworkTraining(Training):
    """How the networks of regions learn.

    Raises:
        ValueError: A number is out of its range; the message names it, the rule and the value.
    """

    children: Literal["copy", "fresh"] = "copy"
    """At a split, children start from copies of their parent's weights, or (2007) as new networks
    trained on the examples that they inherit."""
    fresh_minibatches: int = 100
    """How many steps of the optimiser a fresh child takes when it is born."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("fresh_minibatches", self.fresh_minibatches, least=0)


@dataclass(frozen=True, kw_only=True)
class NetworkExperts(NetworkTraining):
    """A network for each region, of any module, trained on that region's examples alone.

    At every decision the network of the region takes `minibatches` steps down the mean squared
    error of its predictions, in scaled units, over random examples that the region holds.

    Raises:
        ValueError: A number is out of its range, or the module is a network already.

    Source: the networks are this library's; Oudeyer, Kaplan and Hafner (2007) allow any learner.
    """

    module: Factory = field(default_factory=MLP)
    """Makes the network from the numbers of its inputs and outputs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.module, nn.Module):
            name = type(self.module).__name__
            raise ValueError(
                "module must make a network from its numbers of inputs and outputs, as a class or "
                f"a function does, got one that is made: {name}"
            )

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "NetworkPool":
        """Return the networks of a population, one for the root of each agent.

        Raises:
            ValueError: The module cannot be such a network; the message says why.
        """
        networks = StackedNetworks(self.module, situation_dim, outcome_dim, self, device)
        return NetworkPool(networks, self, seeds, device)


@dataclass(frozen=True, kw_only=True)
class MLPExperts(NetworkTraining):
    """A multi-layer perceptron for each region: `NetworkExperts` with the default module.

    Raises:
        ValueError: A number is out of its range; the message names it, the rule and the value.
    """

    hidden: tuple[int, ...] = (32, 32)
    """Units of each hidden layer."""

    def __post_init__(self) -> None:
        super().__post_init__()
        MLP(self.hidden)

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "NetworkPool":
        """Return the networks of a population, one for the root of each agent."""
        networks = StackedNetworks(MLP(self.hidden), situation_dim, outcome_dim, self, device)
        return NetworkPool(networks, self, seeds, device)


class NetworkPool(Stateful):
    """The networks of the regions of a population.

    Args:
        networks: The networks, with one row for each root.
        training: How they learn.
        seeds: One for each agent.
        device: Where they learn.

    Attributes:
        networks: Their weights, a row a leaf.
    """

    saved = ("networks",)

    def __init__(
        self,
        networks: StackedNetworks,
        training: NetworkTraining,
        seeds: Sequence[int],
        device: torch.device,
    ) -> None:
        self.networks = networks
        self._training = training
        self._seeds, self._device = seeds, device
        self._picks = RandomStream(
            seeds, training.minibatches * training.minibatch_size, MINIBATCH_STREAM, device
        )
        roots = torch.arange(len(seeds), device=device)
        networks.reserve(len(seeds))
        networks.start(roots, [_birth_seed(seed, 0) for seed in seeds])

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:  # noqa: ARG002
        """Return the predicted outcomes, shape `(A, K)`, in scaled units."""
        return self.networks.predict(rows, situations[:, None])[:, 0]

    def learn(self, examples: Examples, rows: Tensor, step: int) -> Tensor:
        """Take the decision's steps of the optimiser and return the losses, shape `(A,)`.

        A loss is the mean squared error, in scaled units, over the last minibatch.
        """
        return self._train(examples, rows, self._picks.at(step), self._drawn(self._seeds, step))

    def expert(self, examples: Examples, row: int) -> nn.Module:  # noqa: ARG002
        """Return a copy of the network of a region."""
        return self.networks.network(row)

    def split(self, examples: Examples, split: Split) -> None:
        """Give the children their parents' weights, or new ones trained on what they inherit."""
        self.networks.reserve(split.n_rows)
        if self._training.children == "copy":
            self.networks.copy(split.rows, split.new_rows)
            return
        agents = split.agents.tolist()
        for side, rows in enumerate((split.rows, split.new_rows)):
            regions = (split.left_regions + side).tolist()
            seeds = [
                _birth_seed(self._seeds[agent], region)
                for agent, region in zip(agents, regions, strict=True)
            ]
            self.networks.start(rows, seeds)
            n_picks = self._training.fresh_minibatches * self._training.minibatch_size
            if n_picks:
                picks = RandomStream(seeds, n_picks, MINIBATCH_STREAM, rows.device).at(0)
                self._train(examples, rows, picks, self._drawn(seeds, 0))

    def _drawn(self, seeds: Sequence[int], step: int) -> Drawn:
        """Return what random layers draw from: of each seed its own at each step."""
        if not self.networks.is_random:
            return ()
        keys = ((seed % 2**128, LAYER_STREAM, step) for seed in seeds)
        return [generator_of(key, self._device) for key in keys]

    def _train(self, examples: Examples, rows: Tensor, numbers: Tensor, drawn: Drawn) -> Tensor:
        """Train on the examples that numbers `(F, M * B)` in [0, 1) select."""
        picks = (numbers * examples.counts.take(rows)[:, None]).long()
        situations = pick(examples.situations.index_select(0, rows), picks)
        outcomes = pick(examples.outcomes.index_select(0, rows), picks)
        size = self._training.minibatch_size
        return self.networks.train(rows, situations, outcomes, size, squared_error, drawn)


def _birth_seed(seed: int, region: int) -> int:
    """Return the seed of a region's network; different for all regions of all agents."""
    return seed * 2**24 + region
