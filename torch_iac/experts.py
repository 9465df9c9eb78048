"""Experts: what predicts the outcome of a situation, from the examples of its region.

A kind of expert (`KNNExperts`, `MLPExperts`, ...) is a frozen bundle of numbers, part of the
config; its `pool` is what works: one expert for each leaf of each agent.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from torch_iac import kernels
from torch_iac.counts import check_count
from torch_iac.examples import NO_EXAMPLE_OUTCOME, Examples
from torch_iac.losses import squared_error
from torch_iac.networks import MLP, Factory, StackedNetworks, Training, pick
from torch_iac.randomness import RandomStream
from torch_iac.regions import Split
from torch_iac.state import Stateful

MINIBATCH_STREAM = 1
"""Which of an agent's random streams the examples that networks learn from are drawn from."""


class ExpertPool(Protocol):
    """The experts of a population, one for each row.

    Runs are saved and resumed only with experts that are `Resumable` too.
    """

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:
        """Return the predicted outcomes, shape `(A, K)`, in scaled units.

        Args:
            examples: What the regions hold.
            rows: Shape `(A,)`, which experts are asked.
            situations: Shape `(A, D)`, in the unit cube.
        """

    def learn(self, examples: Examples, rows: Tensor, step: int) -> Tensor | None:
        """Learn, now that each of some rows has a new example.

        Args:
            examples: What the regions hold, the new ones last.
            rows: Shape `(A,)`, one an agent.
            step: The number of the decision.

        Returns:
            Shape `(A,)`, a loss that must be finite; None if there is none.
        """

    def split(self, examples: Examples, split: Split) -> None:
        """Make experts for the children of regions, whose examples have been parted.

        Args:
            examples: What the regions hold now.
            split: The regions that split.
        """


@runtime_checkable
class Experts(Protocol):
    """A kind of expert."""

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> ExpertPool:
        """Return the experts of a population, one for the root of each agent.

        Args:
            situation_dim: D.
            outcome_dim: K.
            seeds: One for each agent.
            device: Where they learn.

        Raises:
            ValueError: There can be no such experts.
        """


@dataclass(frozen=True)
class KNNExperts(Stateful):
    """Nearest neighbours: the mean outcome of the `k` nearest examples of the region.

    Distance is Euclidean in the unit cube; ties go to the older example. With fewer than `k`
    examples all of them count; with none the prediction is 0.5.

    Raises:
        ValueError: `k` is below 1 or too large.

    Source: Oudeyer and Kaplan (2004), section 2.1, which says neither `k` nor the distance.
    """

    k: int = 1
    """How many neighbours are averaged (the papers do not say)."""

    def __post_init__(self) -> None:
        check_count("k", self.k)

    def pool(
        self,
        situation_dim: int,  # noqa: ARG002 - the examples are all there is
        outcome_dim: int,  # noqa: ARG002
        seeds: Sequence[int],  # noqa: ARG002
        device: torch.device,  # noqa: ARG002
    ) -> Self:
        """Return itself: all that nearest neighbours know is in the examples."""
        return self

    def predict(self, examples: Examples, rows: Tensor, situations: Tensor) -> Tensor:
        """Return the predicted outcomes, shape `(A, K)`, in scaled units."""
        distances = kernels.squared_distances(examples.situations, rows, situations)  # (A, N)
        if self.k == 1:
            return examples.outcomes[rows, :, _first_least(distances)]
        outcomes = examples.outcomes.index_select(0, rows)  # (A, K, N)
        nearest = distances.sort(dim=1, stable=True).indices[:, : self.k]
        is_example = distances.gather(1, nearest).isfinite()[:, None]
        neighbours = outcomes.gather(2, nearest[:, None].expand(-1, outcomes.shape[1], -1))
        n_neighbours = is_example.sum(-1)
        # Outcomes are multiples of `UNIT_STEP`: in float64 their sum is exact in any order.
        mean = (neighbours * is_example).double().sum(-1) / n_neighbours
        return torch.where(n_neighbours > 0, mean, NO_EXAMPLE_OUTCOME).float()

    def learn(self, examples: Examples, rows: Tensor, step: int) -> None:
        """Do nothing, for rows `(A,)`: the example is stored already."""

    def split(self, examples: Examples, split: Split) -> None:
        """Do nothing: the examples are parted already."""


def _first_least(distances: Tensor) -> Tensor:
    """Return where the least of each row is, the first of equal ones, shape `(A,)`."""
    if distances.device.type == "cpu":  # where numpy is six times as fast
        return torch.from_numpy(distances.numpy().argmin(axis=1))
    return distances.argmin(dim=1)


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
        if self.children not in ("copy", "fresh"):
            raise ValueError(f"children must be copy or fresh, got {self.children}")
        check_count("fresh_minibatches", self.fresh_minibatches, least=0)


@dataclass(frozen=True, kw_only=True)
class NetworkExperts(NetworkTraining):
    """A network for each region, of any module, trained on that region's examples alone.

    At every decision the network of the region takes `minibatches` steps down the mean squared
    error of its predictions, in scaled units, over random examples that the region holds.

    Source: the networks are this library's; Oudeyer, Kaplan and Hafner (2007) allow any learner.
    """

    module: Factory = field(default_factory=MLP)
    """Makes the network from the numbers of its inputs and outputs."""

    def pool(
        self, situation_dim: int, outcome_dim: int, seeds: Sequence[int], device: torch.device
    ) -> "NetworkPool":
        """Return the networks of a population, one for the root of each agent.

        Raises:
            ValueError: The module's output has the wrong shape, it has no weights, or its factory
                makes different ones from the same seed.
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
        networks: Room for them.
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
        self._seeds = seeds
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
        return self._train(examples, rows, self._picks.at(step))

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
                self._train(examples, rows, picks)

    def _train(self, examples: Examples, rows: Tensor, numbers: Tensor) -> Tensor:
        """Train on the examples that numbers `(F, M * B)` in [0, 1) pick."""
        picks = (numbers * examples.counts.take(rows)[:, None]).long()
        situations = pick(examples.situations.index_select(0, rows), picks)
        outcomes = pick(examples.outcomes.index_select(0, rows), picks)
        size = self._training.minibatch_size
        return self.networks.train(rows, situations, outcomes, size, squared_error)


def _birth_seed(seed: int, region: int) -> int:
    """Return the seed of a region's network; different for all regions of all agents."""
    return seed * 2**24 + region
