"""Many small networks of one shape, each with its own weights, trained side by side.

Shapes: `L` networks (rows), `P` weights of one of them, `M` minibatches, `B` examples in each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from torch_iac.experts.mlp import MLP
from torch_iac.experts.module_trial import try_module
from torch_iac.experts.modules import (
    Drawn,
    Factory,
    Named,
    RowModule,
    buffers_of,
    slopes_of,
    stacked,
    weights_of,
)
from torch_iac.internal import kernels
from torch_iac.internal.losses import LOSSES, Loss, squared_error
from torch_iac.internal.state import Stateful, reserve
from torch_iac.internal.validation import check_count, settle

ELEMENTWISE = (nn.ReLU, nn.LeakyReLU, nn.ELU, nn.GELU, nn.SiLU, nn.Softplus, nn.Tanh, nn.Sigmoid)
"""Elementwise layers."""

MOST_RATE = 1e38
"""Float32 holds no larger step size."""

TINY = 1e-17
"""Added to gradients, too small to change results: otherwise Adam's running means of an inactive
unit decay to denormal numbers, with which processors are many times slower."""


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
    elementwise layers runs as batched matrix products, any other module as `RowModule` calls it;
    the last digits of these may differ between processors, and between one robot and many.

    Buffers, and weights that do not learn, are a row a network like the weights. They change when
    the network learns, never when it predicts.

    Args:
        factory: Makes one network.
        n_inputs: Its inputs.
        n_outputs: Its outputs.
        training: How it learns.
        device: Where the weights are kept.

    Raises:
        ValueError: The module cannot be such a network; the message says why.
    """

    tables: ClassVar = {"_n_rows": ("_weights", "_mean", "_square", "_filled", "_buffers")}

    def __init__(
        self,
        factory: Factory,
        n_inputs: int,
        n_outputs: int,
        training: Training,
        device: torch.device,
    ) -> None:
        self._training = training
        self._n_rows = 0
        self._module = RowModule(factory, n_inputs, n_outputs, device)
        self._sizes = [shape.numel() for shape in self._module.shapes.values()]
        self._layers = _linear_layers(self._module.template)
        if type(factory) is not MLP:
            try_module(self._module, training.minibatch_size)
            self._layers = self._layers if self._is_plain() else []
        self._perceptron = _perceptron_sizes(self._layers) if device.type == "cpu" else []
        self._buffers = {
            name: of.new_empty(0, *of.shape)
            for name, of in buffers_of(self._module.template).items()
        }
        self._weights = torch.empty(0, sum(self._sizes), device=device)
        self._mean = torch.empty_like(self._weights)
        self._square = torch.empty_like(self._weights)
        # Bias corrections of the two running means: 1 - 0.9**n and 1 - 0.999**n after n steps.
        self._filled = torch.empty(0, 2, device=device)
        self._rates = torch.tensor([0.1, 0.001], device=device)
        self._full = torch.ones(2, device=device)

    @property
    def is_random(self) -> bool:
        """Whether they draw random numbers to learn."""
        return self._module.is_random

    def reserve(self, n_rows: int) -> None:
        """Allocate `n_rows` networks."""
        self._n_rows = max(self._n_rows, n_rows)
        self._weights = reserve(self._weights, n_rows)
        self._mean = reserve(self._mean, n_rows)
        self._square = reserve(self._square, n_rows)
        self._filled = reserve(self._filled, n_rows)
        self._buffers = {name: reserve(of, n_rows) for name, of in self._buffers.items()}

    def start(self, rows: Tensor, seeds: Sequence[int]) -> None:
        """Give rows `(F,)` the weights that the factory makes from each seed."""
        made = [self._module.made(seed) for seed in seeds]
        weights = [nn.utils.parameters_to_vector(weights_of(of).values()) for of in made]
        self._weights[rows] = torch.stack(weights).detach()
        for column in self._memory:
            column[rows] = 0.0
        for name, buffers in stacked([buffers_of(of) for of in made]).items():
            self._buffers[name][rows] = buffers.detach()

    def copy(self, rows: Tensor, new_rows: Tensor) -> None:
        """Copy weights, buffers and the optimiser's state from rows `(F,)` to new rows `(F,)`."""
        for column in (self._weights, *self._memory, *self._buffers.values()):
            column[new_rows] = column[rows]

    def network(self, row: int) -> nn.Module:
        """Return a copy of one network, a module of its own that can learn."""
        buffers = {name: of[row] for name, of in self._buffers.items()}
        return self._module.filled(self._weights[row], buffers)

    def predict(self, rows: Tensor, inputs: Tensor) -> Tensor:
        """Return outputs `(A, B, n_outputs)` of networks `(A,)` for inputs `(A, B, n_inputs)`."""
        if self._perceptron:
            return kernels.perceptrons(self._weights, rows, self._perceptron, inputs)
        named = self._named(self._weights.index_select(0, rows))
        if self._layers:
            return self._activations(named, inputs)[-1]
        return self._module.call(named, self._buffers_of(rows), inputs)[0]

    def train(
        self,
        rows: Tensor,
        inputs: Tensor,
        targets: Tensor,
        minibatch_size: int,
        loss: Loss,
        drawn: Drawn = (),
    ) -> Tensor:
        """Take one step of the optimiser for each minibatch.

        Args:
            rows: Shape `(A,)`, different networks.
            inputs: Shape `(A, M * B, n_inputs)`.
            targets: Shape `(A, M * B, n_outputs)`.
            minibatch_size: B.
            loss: Its mean over a minibatch is minimised.
            drawn: What each of the rows draws from, if the networks are random.

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
        buffers, losses = self._buffers_of(rows), targets
        for start in range(0, inputs.shape[1], minibatch_size):
            batch = inputs.narrow(1, start, minibatch_size)
            target = targets.narrow(1, start, minibatch_size)
            if self._layers:
                losses = self._by_hand(named, slopes, batch, target, loss)
            else:
                losses = self._by_autograd(named, slopes, buffers, batch, target, loss, drawn)
            if self._training.optimizer == "sgd":
                weights.sub_(gradient, alpha=self._training.learning_rate)
            else:
                self._adam(weights, gradient, mean, square, filled)
        self._weights.index_copy_(0, rows, weights)
        for column, renewed in zip(self._memory, (mean, square, filled), strict=True):
            column.index_copy_(0, rows, renewed)
        for name, of in buffers.items():
            self._buffers[name].index_copy_(0, rows, of)
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
        self,
        named: Named,
        gradient: Named,
        buffers: Named,
        inputs: Tensor,
        targets: Tensor,
        loss: Loss,
        drawn: Drawn = (),
    ) -> Tensor:
        """Fill in the gradient of the mean loss, renew buffers; return the losses `(A, B, K)`."""
        with torch.enable_grad():
            leaves = {name: part.detach().requires_grad_() for name, part in named.items()}
            outputs, after = self._module.call(leaves, buffers, inputs, True, drawn)
        buffers.update(after)
        losses, slopes = loss(outputs.detach(), targets)
        slopes = slopes / slopes[0].numel()
        for name, part in slopes_of(outputs, leaves, slopes).items():
            gradient[name].copy_(part)
        return losses

    def _by_hand(
        self, named: Named, gradient: Named, inputs: Tensor, targets: Tensor, loss: Loss
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

    def _activations(self, named: Named, inputs: Tensor) -> list[Tensor]:
        """Return the inputs, then the outputs of each layer."""
        activations = [inputs]
        for name, layer in self._layers:
            if isinstance(layer, nn.Linear):
                weight, bias = named[f"{name}.weight"], named[f"{name}.bias"]
                activations.append(torch.baddbmm(bias[:, None], activations[-1], weight.mT))
            else:
                activations.append(layer(activations[-1]))
        return activations

    def _buffers_of(self, rows: Tensor) -> Named:
        """Return a copy of the buffers of some rows."""
        return {name: of.index_select(0, rows) for name, of in self._buffers.items()}

    def _is_plain(self) -> bool:
        """Return whether its layers are all that a `Sequential` does: no hooks, no tied weights."""
        module = self._module
        if not self._layers or buffers_of(module.template):
            return False
        if len(module.shapes) < len(list(module.template.named_parameters(remove_duplicate=False))):
            return False
        generator = torch.Generator().manual_seed(0)
        inputs = torch.rand(1, 2, module.n_inputs, generator=generator).to(module.device)
        weights = nn.utils.parameters_to_vector(module.template.parameters()).detach()[None]
        named = self._named(weights)
        by_hand, by_autograd = (
            self._named(torch.empty_like(weights)),
            self._named(torch.empty_like(weights)),
        )
        targets = torch.zeros(1, 2, module.n_outputs, device=module.device)
        self._by_hand(named, by_hand, inputs, targets, squared_error)
        self._by_autograd(named, by_autograd, {}, inputs, targets, squared_error)
        return all(
            torch.allclose(by_hand[name], of, 1e-3, 1e-5) for name, of in by_autograd.items()
        )

    def _named(self, weights: Tensor) -> Named:
        """Return the parts of weights `(A, P)` by name; they share its memory."""
        parts = torch.split(weights, self._sizes, dim=1)
        return {
            name: part.view(-1, *shape)
            for (name, shape), part in zip(self._module.shapes.items(), parts, strict=True)
        }


def pick(examples: Tensor, picks: Tensor) -> Tensor:
    """Return examples of `(A, D, N)` at places `(A, n)`, shape `(A, n, D)`."""
    return examples.gather(2, picks[:, None].expand(-1, examples.shape[1], -1)).mT


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
