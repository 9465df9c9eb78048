"""A module of which each row has weights and buffers of its own.

Shapes: `A` rows, `P` weights of one of them, `B` situations each.
"""

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from torch_iac.experts.mlp import MLP
from torch_iac.internal.generators import DrawnFrom, generator_of

Factory = Callable[[int, int], nn.Module]
"""Makes a network from its numbers of inputs and outputs."""

Named = dict[str, Tensor]
"""Weights, gradients or buffers by name: of one row, or of several, each `(A, ...)`."""

Drawn = Sequence[torch.Generator]
"""What each row draws random numbers from."""


class RowModule:
    """The module that a factory makes, called for many rows.

    Weights that do not learn (`requires_grad` is off) count as buffers. All rows are called at once
    by `torch.func.vmap`; one by one where `vmap` cannot call the module, and where it draws random
    numbers to learn, which each row has of its own. `module_trial` finds out which it is.

    Args:
        factory: Makes it.
        n_inputs: Its inputs.
        n_outputs: Its outputs.
        device: Where it runs.

    Attributes:
        n_inputs: Its inputs.
        n_outputs: Its outputs.
        device: Where it runs.
        template: The module made from seed 0, in eval mode.
        shapes: The shapes of the weights that learn, by name.
        is_random: Whether it draws random numbers to learn.
        is_batched: Whether `vmap` calls it, in eval mode (False) and in train mode (True).

    Raises:
        ValueError: The factory fails, or makes no module with weights that learn.
    """

    def __init__(
        self, factory: Factory, n_inputs: int, n_outputs: int, device: torch.device
    ) -> None:
        self._factory = factory
        self.n_inputs, self.n_outputs, self.device = n_inputs, n_outputs, device
        self.template = self.made(0).eval()
        self.shapes = {name: of.shape for name, of in weights_of(self.template).items()}
        self._places = _places(self.template)
        self.is_random = False
        self.is_batched = {False: True, True: True}
        learner = _copied(self.template).train()
        self._modes = {False: _WithBuffers(self.template), True: _WithBuffers(learner)}

    def made(self, seed: int) -> nn.Module:
        """Return the module that the factory makes from a seed.

        Raises:
            ValueError: The factory fails, or makes no module with weights that learn.
        """
        generator = generator_of(seed % 2**128)
        if type(self._factory) is MLP:  # in a third of the time
            return self._factory(self.n_inputs, self.n_outputs, generator).to(self.device)
        try:
            with DrawnFrom(generator):
                module = self._factory(self.n_inputs, self.n_outputs)
        except Exception as error:  # whatever a user's factory does
            raise ValueError(
                "a module must be made from its numbers of inputs and outputs, got "
                f"{type(error).__name__} for {self.n_inputs} and {self.n_outputs}: {error}"
            ) from error
        _check_weights(module)
        return module.to(self.device, torch.float32)

    def in_mode(self, is_learning: bool) -> nn.Module:
        """Return the module that is called, in eval mode or in train mode."""
        return self._modes[is_learning].module

    def filled(self, weights: Tensor, buffers: Mapping[str, Tensor]) -> nn.Module:
        """Return a module that can learn on its own, with the weights `(P,)` and buffers of a row.

        It is in eval mode.
        """
        module = _copied(self.template)
        nn.utils.vector_to_parameters(weights.clone(), weights_of(module).values())
        with torch.no_grad():
            for name, buffer in buffers_of(module).items():
                buffer.copy_(buffers[name])
        return module

    def call(
        self,
        weights: Named,
        buffers: Named,
        inputs: Tensor,
        is_learning: bool = False,
        drawn: Drawn = (),
    ) -> tuple[Tensor, Named]:
        """Return the outputs of some rows, and their buffers after that.

        Args:
            weights: Those that learn, each `(A, ...)`.
            buffers: Each `(A, ...)`; the module may overwrite them.
            inputs: Shape `(A, B, n_inputs)`.
            is_learning: Whether the module is in train mode.
            drawn: What each row draws from; without it the module must not draw.

        Returns:
            Shape `(A, B, n_outputs)`, and each `(A, ...)`.
        """
        whole = self._modes[is_learning]

        def call_one(weights: Named, buffers: Named, inputs: Tensor) -> tuple[Tensor, Named]:
            given = {**weights, **buffers}
            named = {f"module.{place}": given[name] for place, name in self._places.items()}
            # Its own `tie_weights` leaves a module changed in which one layer stands twice.
            answer: tuple[Tensor, Named] = functional_call(
                whole, named, (inputs,), tie_weights=False
            )
            return answer

        if not drawn and len(inputs) == 1:  # half the time that it takes with `vmap`
            outputs, after = call_one(_row(weights, 0), _row(buffers, 0), inputs[0])
            return outputs[None], buffers | stacked([after])
        if not drawn and self.is_batched[is_learning]:
            outputs, after = vmap(call_one)(weights, buffers, inputs)
            return outputs, buffers | after
        answers = []
        for row, given in enumerate(inputs):
            with DrawnFrom(drawn[row] if drawn else None):
                answers.append(call_one(_row(weights, row), _row(buffers, row), given))
        return torch.stack([of for of, _ in answers]), buffers | stacked([of for _, of in answers])


class _WithBuffers(nn.Module):
    """A module that returns its buffers beside its outputs, so that they can be kept."""

    def __init__(self, module: nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, inputs: Tensor) -> tuple[Tensor, Named]:
        outputs = self.module(inputs)
        return outputs, {name: of.detach() for name, of in self.module.named_buffers()}


def weights_of(module: nn.Module) -> Named:
    """Return the weights of a module that learn."""
    return {name: of for name, of in module.named_parameters() if of.requires_grad}


def buffers_of(module: nn.Module) -> Named:
    """Return the buffers of a module, and its weights that do not learn."""
    fixed = {name: of for name, of in module.named_parameters() if not of.requires_grad}
    return {**fixed, **dict(module.named_buffers())}


def _places(module: nn.Module) -> dict[str, str]:
    """Return where in a module weights and buffers are, each with its name, which may be shared."""
    named = [*module.named_parameters(), *module.named_buffers()]
    names = {id(tensor): name for name, tensor in named}
    places = {}
    for where, layer in module.named_modules():
        for own in (layer.named_parameters, layer.named_buffers):
            for name, tensor in own(recurse=False, remove_duplicate=False):
                places[f"{where}.{name}" if where else name] = names[id(tensor)]
    return places


def slopes_of(outputs: Tensor, weights: Named, slopes: Tensor) -> Named:
    """Return the gradient by weights `(A, ...)`, given that by outputs `(A, B, n_outputs)`."""
    parts = torch.autograd.grad(
        outputs, list(weights.values()), slopes, allow_unused=True, materialize_grads=True
    )
    return dict(zip(weights, parts, strict=True))


def stacked(rows: Iterable[Mapping[str, Tensor]]) -> Named:
    """Return what rows have, each tensor `(A, ...)`."""
    first, *others = [dict(row) for row in rows]
    return {name: torch.stack([of[name] for of in (first, *others)]) for name in first}


def _row(named: Named, row: int) -> Named:
    return {name: of[row] for name, of in named.items()}


def _copied(module: nn.Module) -> nn.Module:
    try:
        return copy.deepcopy(module)
    except Exception as error:  # such as tensors that were computed from weights
        raise ValueError(
            f"a module must be one that copy.deepcopy can copy, got {type(module).__name__}: "
            f"{error}"
        ) from error


def _check_weights(module: object) -> None:
    if not isinstance(module, nn.Module):
        raise ValueError(f"a module's factory must return a module, got {module!r:.80}")
    for name, weights in module.named_parameters():
        if isinstance(weights, nn.parameter.UninitializedParameter):
            raise ValueError(
                f"a module's weights must have their shapes when it is made, got {name} without one"
            )
        if weights.is_complex():
            raise ValueError(f"a module's weights must be real numbers, got complex ones in {name}")
    if not weights_of(module):
        raise ValueError("a module must have weights to learn, got none")
