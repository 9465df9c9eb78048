"""Many small networks of one shape, each with its own weights, trained side by side.

Shapes: `L` networks (rows), `P` weights of one of them, `M` minibatches, `B` examples in each.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap
from torch.nn.functional import mse_loss

from torch_iac.state import Stateful
from torch_iac.table import reserve

Factory = Callable[[int, int], nn.Module]
"""Makes a network from its numbers of inputs and outputs."""

Loss = Callable[[Tensor, Tensor], Tensor]
"""Compares predictions with targets, both `(A, B, K)`, element by element."""

ELEMENTWISE = (nn.ReLU, nn.LeakyReLU, nn.ELU, nn.GELU, nn.SiLU, nn.Softplus, nn.Tanh, nn.Sigmoid)
"""Layers that do the same to every number, whatever the shape around it."""


TINY = 1e-18
"""Added to gradients, far below what changes anything: the optimiser's memory of a unit that has
gone quiet would else fade into denormal numbers, with which processors are many times slower."""


@dataclass(frozen=True)
class MLP:
    """Makes multi-layer perceptrons with ReLU.

    Raises:
        ValueError: A layer has no units.
    """

    hidden: tuple[int, ...] = (32, 32)
    """Units of each hidden layer."""

    def __post_init__(self) -> None:
        if any(units < 1 for units in self.hidden):
            raise ValueError(f"hidden must be at least 1 unit a layer, got {self.hidden}")

    def __call__(self, n_inputs: int, n_outputs: int) -> nn.Module:
        """Return a new network."""
        sizes = (n_inputs, *self.hidden)
        layers: list[nn.Module] = []
        for n_in, n_out in pairwise(sizes):
            layers += [nn.Linear(n_in, n_out), nn.ReLU()]
        return nn.Sequential(*layers, nn.Linear(sizes[-1], n_outputs))


@dataclass(frozen=True, kw_only=True)
class Training:
    """How networks learn at each decision."""

    learning_rate: float = 0.01
    """Step size of the optimiser."""
    minibatches: int = 4
    """How many steps of the optimiser a decision."""
    minibatch_size: int = 32
    """How many examples each step looks at, drawn with replacement."""
    optimizer: Literal["adam", "sgd"] = "adam"
    """Adam (Kingma and Ba, 2015) with its usual constants, or plain gradient descent."""

    def __post_init__(self) -> None:
        if not 0 < self.learning_rate < math.inf:
            raise ValueError(f"learning_rate must be above 0, got {self.learning_rate}")
        for name in ("minibatches", "minibatch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.optimizer not in ("adam", "sgd"):
            raise ValueError(f"optimizer must be adam or sgd, got {self.optimizer}")


class StackedNetworks(Stateful):
    """Networks of one shape; row `i` of each tensor belongs to network `i`.

    A `Sequential` of linear and elementwise layers runs as batched matrix products, anything else
    through `torch.func.vmap`. On the CPU a network of linear layers and ReLU learns the same to the
    bit whatever other rows there are; other modules may differ in the last digits.

    Args:
        factory: Makes one network.
        n_inputs: Its inputs.
        n_outputs: Its outputs.
        training: How it learns.
        device: Where the weights are kept.

    Raises:
        ValueError: The network's output has the wrong shape, it has no weights, or the factory
            makes different ones from the same seed.
    """

    tables: ClassVar = {"_n_rows": ("_weights", "_mean", "_square", "_filled")}

    def __init__(
        self,
        factory: Factory,
        n_inputs: int,
        n_outputs: int,
        training: Training,
        device: torch.device,
    ) -> None:
        self._make = partial(factory, n_inputs, n_outputs)
        self._training = training
        self._device = device
        self._n_rows = 0
        self._template = self._made(0).to(device).eval().requires_grad_(False)
        self._check(n_inputs, n_outputs)
        shapes = {name: p.shape for name, p in self._template.named_parameters()}
        self._shapes = shapes
        self._sizes = [shape.numel() for shape in shapes.values()]
        self._layers = _linear_layers(self._template)
        self._weights = torch.empty(0, sum(self._sizes), device=device)
        self._mean = torch.empty_like(self._weights)
        self._square = torch.empty_like(self._weights)
        # How full the two running means are: 1 - 0.9**n and 1 - 0.999**n after n steps.
        self._filled = torch.empty(0, 2, device=device)
        self._rates = torch.tensor([0.1, 0.001], device=device)

    def reserve(self, n_rows: int) -> None:
        """Make room for `n_rows` networks."""
        self._n_rows = max(self._n_rows, n_rows)
        self._weights = reserve(self._weights, n_rows, 0.0)
        self._mean = reserve(self._mean, n_rows, 0.0)
        self._square = reserve(self._square, n_rows, 0.0)
        self._filled = reserve(self._filled, n_rows, 0.0)

    def start(self, rows: Tensor, seeds: Sequence[int]) -> None:
        """Give rows `(F,)` the weights that the factory makes from each seed."""
        made = [nn.utils.parameters_to_vector(self._made(seed).parameters()) for seed in seeds]
        self._weights[rows] = torch.stack(made).detach().to(self._device)
        for column in self._memory:
            column[rows] = 0.0

    def copy(self, rows: Tensor, new_rows: Tensor) -> None:
        """Copy weights, and what the optimiser remembers, from rows `(F,)` to new rows `(F,)`."""
        for column in (self._weights, *self._memory):
            column[new_rows] = column[rows]

    def predict(self, rows: Tensor, inputs: Tensor) -> Tensor:
        """Return what networks `(A,)` make of inputs `(A, B, n_inputs)`: `(A, B, n_outputs)`."""
        return self._forward(self._weights.index_select(0, rows), inputs)

    def train(
        self, rows: Tensor, inputs: Tensor, targets: Tensor, minibatch_size: int, loss: Loss
    ) -> Tensor:
        """Take one step of the optimiser for each minibatch.

        Args:
            rows: Shape `(A,)`, different networks.
            inputs: Shape `(A, M * B, n_inputs)`.
            targets: Shape `(A, M * B, n_outputs)`.
            minibatch_size: B.
            loss: Its mean over a minibatch is made smaller.

        Returns:
            Shape `(A,)`, the loss in the last minibatch, before its step.
        """
        weights = self._weights.index_select(0, rows)
        memory = [column.index_select(0, rows) for column in self._memory]
        losses = weights.new_zeros(len(rows))
        for start in range(0, inputs.shape[1], minibatch_size):
            batch = inputs.narrow(1, start, minibatch_size)
            target = targets.narrow(1, start, minibatch_size)
            with torch.enable_grad():
                weights.requires_grad_()
                errors = loss(self._forward(weights, batch), target)
                losses = errors.flatten(1).mean(1)
                (gradient,) = torch.autograd.grad(losses.sum(), weights)
            losses, weights = losses.detach(), self._step(weights.detach(), gradient, *memory)
        self._weights.index_copy_(0, rows, weights)
        for column, renewed in zip(self._memory, memory, strict=True):
            column.index_copy_(0, rows, renewed)
        return losses

    @property
    def _memory(self) -> tuple[Tensor, Tensor, Tensor]:
        """What the optimiser remembers of each network."""
        return self._mean, self._square, self._filled

    def _step(
        self, weights: Tensor, gradient: Tensor, mean: Tensor, square: Tensor, filled: Tensor
    ) -> Tensor:
        """Return the weights after one step; what the optimiser remembers is renewed in place."""
        rate = self._training.learning_rate
        if self._training.optimizer == "sgd":
            return weights.sub_(gradient, alpha=rate)
        gradient = gradient + TINY
        filled.lerp_(torch.ones_like(filled), self._rates.expand_as(filled))
        mean.lerp_(gradient, 0.1)
        square.lerp_(gradient.square(), 0.001)
        scale = (square / filled[:, 1:]).sqrt_().add_(1e-8)
        return weights.addcdiv_(mean / filled[:, :1], scale, value=-rate)

    def _forward(self, weights: Tensor, inputs: Tensor) -> Tensor:
        parts = torch.split(weights, self._sizes, dim=1)
        named = {
            name: part.view(-1, *shape)
            for (name, shape), part in zip(self._shapes.items(), parts, strict=True)
        }
        if self._layers is None:
            outputs: Tensor = vmap(self._call)(named, inputs)
            return outputs
        for name, layer in self._layers:
            if isinstance(layer, nn.Linear):
                inputs = _linear(inputs, named[f"{name}.weight"], named[f"{name}.bias"][:, None])
            else:
                inputs = layer(inputs)
        return inputs

    def _call(self, named: dict[str, Tensor], inputs: Tensor) -> Tensor:
        outputs: Tensor = functional_call(self._template, named, (inputs,))
        return outputs

    def _made(self, seed: int) -> nn.Module:
        # torch on the CPU heeds 32 bits of a seed only, so all of them are mixed into these.
        mixed = np.random.SeedSequence(seed % 2**128).generate_state(1).item()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(mixed)
            return self._make()

    def _check(self, n_inputs: int, n_outputs: int) -> None:
        if not any(True for _ in self._template.parameters()):
            raise ValueError("a module must have weights to learn, got none")
        inputs = torch.zeros(2, n_inputs, device=self._device)
        outputs = self._template(inputs)
        if tuple(outputs.shape) != (2, n_outputs):
            raise ValueError(
                f"a module must turn situations (n, {n_inputs}) into outcomes (n, {n_outputs}), "
                f"got {tuple(outputs.shape)} for n = 2"
            )
        again = self._made(0).to(self._device)
        pairs = zip(self._template.parameters(), again.parameters(), strict=True)
        if not all(torch.equal(one, other) for one, other in pairs):
            raise ValueError(
                "a module's factory must make the same weights from the same seed, "
                "got different ones: it must draw from torch's own generator"
            )


def pick(examples: Tensor, picks: Tensor) -> Tensor:
    """Return examples of `(A, D, N)` at places `(A, n)`, shape `(A, n, D)`."""
    return examples.gather(2, picks[:, None].expand(-1, examples.shape[1], -1)).mT


def squared_error(predictions: Tensor, targets: Tensor) -> Tensor:
    """Return the squared error of each number."""
    return mse_loss(predictions, targets, reduction="none")


def _linear(inputs: Tensor, weights: Tensor, biases: Tensor) -> Tensor:
    """Return inputs `(A, B, n_in)` through each network's own layer, to the bit as if alone."""
    if 1 in weights.shape[1:]:  # a product with a vector rounds otherwise alone than in a batch
        return (inputs[:, :, None] * weights[:, None]).sum(dim=3) + biases
    return torch.baddbmm(biases, inputs, weights.mT)


def _linear_layers(module: nn.Module) -> list[tuple[str, nn.Module]] | None:
    """Return the named layers of a plain `Sequential`; None for any other module."""
    layers = list(module.named_children())
    plain = isinstance(module, nn.Sequential) and all(
        isinstance(layer, (nn.Linear, *ELEMENTWISE)) for _, layer in layers
    )
    biased = all(layer.bias is not None for _, layer in layers if isinstance(layer, nn.Linear))
    return layers if plain and biased else None
