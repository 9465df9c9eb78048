"""Many small networks of one shape, each with its own weights, trained side by side.

Shapes: `L` networks (rows), `P` weights of one of them, `M` minibatches, `B` examples in each.
"""

import copy
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

from torch_iac.internal import kernels
from torch_iac.internal.losses import LOSSES, Loss
from torch_iac.internal.state import Stateful, reserve
from torch_iac.internal.validation import check_count, settle

Factory = Callable[[int, int], nn.Module]
"""Makes a network from its numbers of inputs and outputs."""

Weights = dict[str, Tensor]
"""The weights of some networks, or their gradients, by name, each `(A, ...)`."""

ELEMENTWISE = (nn.ReLU, nn.LeakyReLU, nn.ELU, nn.GELU, nn.SiLU, nn.Softplus, nn.Tanh, nn.Sigmoid)
"""Elementwise layers."""

MOST_RATE = 1e38
"""Float32 holds no larger step size."""

TINY = 1e-17
"""Added to gradients, too small to change results: otherwise Adam's running means of an inactive
unit decay to denormal numbers, with which processors are many times slower."""


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

    def __call__(self, n_inputs: int, n_outputs: int) -> nn.Module:
        """Return a new network, from numbers `(n, n_inputs)` to numbers `(n, n_outputs)`."""
        layers: list[nn.Module] = []
        for n_in, n_out in self.sizes(n_inputs, n_outputs):
            layers += [_linear_layer(n_in, n_out), nn.ReLU()]
        return nn.Sequential(*layers[:-1])

    def sizes(self, n_inputs: int, n_outputs: int) -> list[tuple[int, int]]:
        """Return the numbers of inputs and outputs of each layer."""
        return list(pairwise((n_inputs, *self.hidden, n_outputs)))


@dataclass(frozen=True, kw_only=True)
class Training:
    """How networks learn at each decision.

    Raises:
        ValueError: A number is out of its range; the message names it, the rule and the value.

    Source: the networks and their numbers are this library's; the papers have none.
    """

    learning_rate: float = 0.01
    """Step size of the optimiser."""
    minibatches: int = 4
    """How many steps of the optimiser a decision."""
    minibatch_size: int = 32
    """How many examples each step looks at, drawn with replacement."""
    optimizer: Literal["adam", "sgd"] = "adam"
    """Adam (Kingma and Ba, 2015) with its usual constants, or plain gradient descent."""

    def __post_init__(self) -> None:
        settle(self)
        if not 0 < self.learning_rate < math.inf:
            raise ValueError(f"learning_rate must be above 0, got {self.learning_rate}")
        if self.learning_rate > MOST_RATE:
            raise ValueError(
                f"learning_rate must be at most {MOST_RATE:g}, got {self.learning_rate}"
            )
        for name in ("minibatches", "minibatch_size"):
            check_count(name, getattr(self, name))


class StackedNetworks(Stateful):
    """Networks of one shape; row `i` of each tensor belongs to network `i`.

    On the CPU linear layers with ReLU between them run in `kernels`: the same to the bit on every
    x86-64 processor, whatever other rows there are. Any other `Sequential` of linear and
    elementwise layers runs as batched matrix products, any other module through `torch.func.vmap`;
    the last digits of these may differ between processors, and between one robot and many.

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
        self._perceptron = _perceptron_sizes(self._layers) if device.type == "cpu" else []
        self._weights = torch.empty(0, sum(self._sizes), device=device)
        self._mean = torch.empty_like(self._weights)
        self._square = torch.empty_like(self._weights)
        # Bias corrections of the two running means: 1 - 0.9**n and 1 - 0.999**n after n steps.
        self._filled = torch.empty(0, 2, device=device)
        self._rates = torch.tensor([0.1, 0.001], device=device)
        self._full = torch.ones(2, device=device)

    def reserve(self, n_rows: int) -> None:
        """Allocate `n_rows` networks."""
        self._n_rows = max(self._n_rows, n_rows)
        self._weights = reserve(self._weights, n_rows)
        self._mean = reserve(self._mean, n_rows)
        self._square = reserve(self._square, n_rows)
        self._filled = reserve(self._filled, n_rows)

    def start(self, rows: Tensor, seeds: Sequence[int]) -> None:
        """Give rows `(F,)` the weights that the factory makes from each seed."""
        made = [nn.utils.parameters_to_vector(self._made(seed).parameters()) for seed in seeds]
        self._weights[rows] = torch.stack(made).detach().to(self._device)
        for column in self._memory:
            column[rows] = 0.0

    def copy(self, rows: Tensor, new_rows: Tensor) -> None:
        """Copy weights, and the optimiser's state, from rows `(F,)` to new rows `(F,)`."""
        for column in (self._weights, *self._memory):
            column[new_rows] = column[rows]

    def network(self, row: int) -> nn.Module:
        """Return a copy of one network, a module of its own that can learn."""
        module = copy.deepcopy(self._template).requires_grad_(True)
        nn.utils.vector_to_parameters(self._weights[row].clone(), module.parameters())
        return module

    def predict(self, rows: Tensor, inputs: Tensor) -> Tensor:
        """Return outputs `(A, B, n_outputs)` of networks `(A,)` for inputs `(A, B, n_inputs)`."""
        if self._perceptron:
            return kernels.perceptrons(self._weights, rows, self._perceptron, inputs)
        named = self._named(self._weights.index_select(0, rows))
        return self._activations(named, inputs)[-1] if self._layers else self._call(named, inputs)

    def train(
        self, rows: Tensor, inputs: Tensor, targets: Tensor, minibatch_size: int, loss: Loss
    ) -> Tensor:
        """Take one step of the optimiser for each minibatch.

        Args:
            rows: Shape `(A,)`, different networks.
            inputs: Shape `(A, M * B, n_inputs)`.
            targets: Shape `(A, M * B, n_outputs)`.
            minibatch_size: B.
            loss: Its mean over a minibatch is minimised.

        Returns:
            Shape `(A,)`, the loss in the last minibatch, before its step.
        """
        if self._perceptron and loss in LOSSES:
            return kernels.train_perceptrons(
                *(self._weights, self._memory, rows, self._perceptron, inputs, targets),
                *(minibatch_size, LOSSES.index(loss), self._training.optimizer),
                *(self._training.learning_rate, TINY),
            )
        weights = self._weights.index_select(0, rows)
        mean, square, filled = (column.index_select(0, rows) for column in self._memory)
        gradient = torch.empty_like(weights)
        named, slopes = self._named(weights), self._named(gradient)
        fill = self._by_hand if self._layers else self._by_autograd
        losses = targets
        for start in range(0, inputs.shape[1], minibatch_size):
            batch = inputs.narrow(1, start, minibatch_size)
            target = targets.narrow(1, start, minibatch_size)
            losses = fill(named, slopes, batch, target, loss)
            if self._training.optimizer == "sgd":
                weights.sub_(gradient, alpha=self._training.learning_rate)
            else:
                self._adam(weights, gradient, mean, square, filled)
        self._weights.index_copy_(0, rows, weights)
        for column, renewed in zip(self._memory, (mean, square, filled), strict=True):
            column.index_copy_(0, rows, renewed)
        return losses.flatten(1).mean(1)

    @property
    def _memory(self) -> tuple[Tensor, Tensor, Tensor]:
        """The optimiser's state of each network."""
        return self._mean, self._square, self._filled

    def _adam(
        self, weights: Tensor, gradient: Tensor, mean: Tensor, square: Tensor, filled: Tensor
    ) -> None:
        """Update the weights, and the optimiser's state, by one step."""
        gradient.add_(TINY)
        mean.lerp_(gradient, 0.1)
        square.mul_(0.999).addcmul_(gradient, gradient, value=0.001)
        filled.lerp_(self._full, self._rates)
        scale = (square / filled[:, 1:]).sqrt_().add_(1e-8).mul_(filled[:, :1])
        weights.addcdiv_(mean, scale, value=-self._training.learning_rate)

    def _by_autograd(
        self, named: Weights, gradient: Weights, inputs: Tensor, targets: Tensor, loss: Loss
    ) -> Tensor:
        """Fill in the gradient of the mean loss; return the losses `(A, B, K)`."""
        with torch.enable_grad():
            leaves = {name: part.detach().requires_grad_() for name, part in named.items()}
            outputs = self._call(leaves, inputs)
        losses, slopes = loss(outputs.detach(), targets)
        slopes = slopes / slopes[0].numel()
        parts = torch.autograd.grad(
            outputs, list(leaves.values()), slopes, allow_unused=True, materialize_grads=True
        )
        for whole, part in zip(gradient.values(), parts, strict=True):
            whole.copy_(part)
        return losses

    def _by_hand(
        self, named: Weights, gradient: Weights, inputs: Tensor, targets: Tensor, loss: Loss
    ) -> Tensor:
        """Do what `_by_autograd` does, layer by layer: twice as fast for small networks."""
        activations = self._activations(named, inputs)
        losses, slopes = loss(activations.pop(), targets)
        slopes = slopes / slopes[0].numel()
        for name, layer in reversed(self._layers):
            before = activations.pop()
            if not isinstance(layer, nn.Linear):
                slopes = _slopes_before(layer, before, slopes)
                continue
            gradient[f"{name}.weight"].copy_(torch.bmm(slopes.mT, before))
            torch.sum(slopes, dim=1, out=gradient[f"{name}.bias"])
            if activations:
                slopes = torch.bmm(slopes, named[f"{name}.weight"])
        return losses

    def _activations(self, named: Weights, inputs: Tensor) -> list[Tensor]:
        """Return the inputs, then the outputs of each layer."""
        activations = [inputs]
        for name, layer in self._layers:
            if isinstance(layer, nn.Linear):
                weight, bias = named[f"{name}.weight"], named[f"{name}.bias"]
                activations.append(torch.baddbmm(bias[:, None], activations[-1], weight.mT))
            else:
                activations.append(layer(activations[-1]))
        return activations

    def _named(self, weights: Tensor) -> Weights:
        """Return the parts of weights `(A, P)` by name; they share its memory."""
        parts = torch.split(weights, self._sizes, dim=1)
        return {
            name: part.view(-1, *shape)
            for (name, shape), part in zip(self._shapes.items(), parts, strict=True)
        }

    def _call(self, named: Weights, inputs: Tensor) -> Tensor:
        if len(inputs) == 1:  # one network needs no vmap, which takes about twice as long
            alone = {name: part[0] for name, part in named.items()}
            return self._call_one(alone, inputs[0])[None]
        outputs: Tensor = vmap(self._call_one)(named, inputs)
        return outputs

    def _call_one(self, named: Weights, inputs: Tensor) -> Tensor:
        outputs: Tensor = functional_call(self._template, named, (inputs,))
        return outputs

    def _made(self, seed: int) -> nn.Module:
        # torch on the CPU uses only 32 bits of a seed, so all 64 are mixed into these.
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


def _linear_layer(n_inputs: int, n_outputs: int) -> nn.Linear:
    """Return a linear layer with torch's usual initial weights, the same on every processor.

    They are uniform within 1 / sqrt(n_inputs), from the same random numbers as `nn.Linear`'s own,
    whose `uniform_` rounds as the processor does.
    """
    layer: nn.Linear = nn.utils.skip_init(nn.Linear, n_inputs, n_outputs)  # type: ignore[no-untyped-call]
    with torch.no_grad():
        for weights in (layer.weight, layer.bias):
            weights.copy_((torch.rand(weights.shape) * 2 - 1) * (1 / math.sqrt(n_inputs)))
    return layer


def _slopes_before(layer: nn.Module, before: Tensor, slopes: Tensor) -> Tensor:
    """Return the gradient by an elementwise layer's inputs, given that by its outputs."""
    if isinstance(layer, nn.ReLU):
        passed: Tensor = torch.ops.aten.threshold_backward(slopes, before, 0)
        return passed
    with torch.enable_grad():
        before = before.detach().requires_grad_()
        (slopes,) = torch.autograd.grad(layer(before), before, slopes)
    return slopes


def _linear_layers(module: nn.Module) -> list[tuple[str, nn.Module]]:
    """Return the named layers of a plain `Sequential`; none for any other module."""
    if not isinstance(module, nn.Sequential):
        return []
    layers = [(str(place), layer) for place, layer in enumerate(module)]
    linear = [layer for layer in module if isinstance(layer, nn.Linear)]
    known = all(type(layer) in (nn.Linear, *ELEMENTWISE) for layer in module)
    own = len(set(linear)) == len(linear) and all(layer.bias is not None for layer in linear)
    return layers if known and own else []


def _perceptron_sizes(layers: list[tuple[str, nn.Module]]) -> list[int]:
    """Return the sizes of linear layers that have ReLU between them; none for any other layers."""
    linear = [layer for _, layer in layers[::2] if isinstance(layer, nn.Linear)]
    between = [layer for _, layer in layers[1::2] if isinstance(layer, nn.ReLU)]
    if len(linear) + len(between) != len(layers) or len(between) != len(linear) - 1:
        return []
    return [*(layer.in_features for layer in linear), linear[-1].out_features]
