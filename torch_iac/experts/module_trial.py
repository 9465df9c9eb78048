"""Tries a module before it is the network of regions: whether it can be, and how it is called."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from torch_iac.experts.modules import (
    Drawn,
    Named,
    RowModule,
    buffers_of,
    slopes_of,
    stacked,
    weights_of,
)
from torch_iac.internal.generators import DrawnFrom

OWN_ATTRIBUTES = frozenset(vars(nn.Module()))
"""The attributes in which every module keeps its parts."""

RELATIVE, ABSOLUTE = 1e-3, 1e-5
"""How far two ways to compute the same may differ by rounding."""


def try_module(module: RowModule, batch_size: int) -> None:
    """Let two rows of a module predict and learn, and note in it how it can be called.

    Args:
        module: The module.
        batch_size: From how many situations at once it will learn.

    Raises:
        ValueError: It cannot predict or learn; the message says why, and in which layer.
    """
    rows = [module.made(0), module.made(1)]
    alike = (module.template, rows[0])
    for states in zip(*([*row.parameters(), *row.buffers()] for row in alike), strict=True):
        if not torch.equal(*states):
            raise ValueError(
                "a module's factory must make the same weights from the same seed, "
                "got different ones: it must draw from torch's own generator"
            )
    for n in (2, 1):
        with _naming_layer(module, is_learning=False), torch.no_grad(), DrawnFrom(None):
            outputs = module.template(torch.zeros(n, module.n_inputs, device=module.device))
        _check_shape(module, outputs, n)
    trial = _Trial(module, rows, batch_size)
    for is_learning in (False, True):
        module.is_batched[is_learning] = False
        with _keeping_attributes(module, is_learning), _naming_layer(module, is_learning):
            alone = trial.answer(is_learning)
            again = trial.answer(is_learning)
        _check_answers(module, alone, again)
        if not (is_learning and module.is_random):
            module.is_batched[is_learning] = trial.can_be_batched(is_learning, alone)


class _Trial:
    """Two rows with situations.

    Args:
        module: Whose rows they are.
        rows: The rows.
        batch_size: How many situations each row gets.
    """

    def __init__(self, module: RowModule, rows: Sequence[nn.Module], batch_size: int) -> None:
        self._module = module
        self._weights = stacked([weights_of(row) for row in rows])
        self._buffers = stacked([buffers_of(row) for row in rows])
        shape = (len(rows), batch_size, module.n_inputs)
        self._inputs = torch.rand(shape, generator=torch.Generator().manual_seed(0)).to(
            module.device
        )

    def answer(self, is_learning: bool) -> Named:
        """Return outputs, buffers after them and slopes; note whether random numbers were drawn."""
        if not is_learning:
            return self._answer(is_learning, ())
        drawn = [torch.Generator(self._module.device).manual_seed(0) for _ in self._inputs]
        before = [generator.get_state() for generator in drawn]
        answer = self._answer(is_learning, drawn)
        after = [generator.get_state() for generator in drawn]
        self._module.is_random = not all(map(torch.equal, before, after))
        return answer

    def can_be_batched(self, is_learning: bool, alone: Named) -> bool:
        """Return whether `vmap` calls the module, with the answer that its rows give alone."""
        self._module.is_batched[is_learning] = True
        try:
            with DrawnFrom(None):
                return _is_close(self._answer(is_learning, ()), alone)
        except Exception:  # whatever `vmap` does not take
            return False

    def _answer(self, is_learning: bool, drawn: Drawn) -> Named:
        weights = {name: of.detach().clone() for name, of in self._weights.items()}
        buffers = {name: of.detach().clone() for name, of in self._buffers.items()}
        with torch.set_grad_enabled(is_learning):
            leaves = {name: of.requires_grad_(is_learning) for name, of in weights.items()}
            outputs, after = self._module.call(leaves, buffers, self._inputs, is_learning, drawn)
        answer = {"outputs": outputs.detach(), **{f"buffer {n}": of for n, of in after.items()}}
        if is_learning:
            slopes = slopes_of(outputs, leaves, outputs.detach())
            answer |= {f"slope {name}": of for name, of in slopes.items()}
        return answer


def _check_shape(module: RowModule, outputs: object, n: int) -> None:
    got = tuple(outputs.shape) if isinstance(outputs, Tensor) else type(outputs).__name__
    if got != (n, module.n_outputs):
        raise ValueError(
            f"a module must turn situations (n, {module.n_inputs}) into outcomes "
            f"(n, {module.n_outputs}), got {got} for n = {n}"
        )


def _check_answers(module: RowModule, answer: Named, again: Named) -> None:
    buffers = buffers_of(module.template)
    for name, buffer in buffers.items():
        after = answer[f"buffer {name}"]
        if (after.dtype, after.shape[1:]) != (buffer.dtype, buffer.shape):
            raise ValueError(
                f"a module's buffers must keep their types and shapes, got {after.dtype} of "
                f"{tuple(after.shape[1:])} for {name}, which was {buffer.dtype} of "
                f"{tuple(buffer.shape)}"
            )
    if not _is_close(answer, again):
        raise ValueError(
            "a module must give the same answer twice, got another one: "
            "it must draw from torch's own generator"
        )


def _is_close(answer: Named, other: Named) -> bool:
    return answer.keys() == other.keys() and all(
        torch.allclose(of.double(), other[name].double(), RELATIVE, ABSOLUTE, equal_nan=True)
        for name, of in answer.items()
    )


@contextmanager
def _naming_layer(module: RowModule, is_learning: bool) -> Iterator[None]:
    """Turn errors of a module into one that names the layer.

    Raises:
        ValueError: There is one.
    """
    whole = module.in_mode(is_learning)
    running: list[str] = []
    hooks = []
    for name, layer in whole.named_modules():
        label = f"layer {name} ({type(layer).__name__})" if name else type(layer).__name__
        hooks.append(layer.register_forward_pre_hook(_noting(running, label)))
        hooks.append(layer.register_forward_hook(_leaving(running)))
    try:
        yield
    except Exception as error:  # whatever a user's module does
        doing = "learn" if is_learning else "predict"
        where = running[-1] if running else type(whole).__name__
        raise ValueError(
            f"a module must {doing} outcomes (n, {module.n_outputs}) from situations "
            f"(n, {module.n_inputs}), got {type(error).__name__} in {where}: {error}"
        ) from error
    finally:
        for hook in hooks:
            hook.remove()


def _noting(running: list[str], label: str) -> Callable[..., None]:
    return lambda *_: running.append(label)


def _leaving(running: list[str]) -> Callable[..., None]:
    def leave(*_: object) -> None:
        running.pop()

    return leave


@contextmanager
def _keeping_attributes(module: RowModule, is_learning: bool) -> Iterator[None]:
    """Refuse a module that remembers something outside of its buffers.

    Raises:
        ValueError: It does.
    """
    whole = module.in_mode(is_learning)
    before = _attributes(whole)
    yield
    after = _attributes(whole)
    for where, value in after.items():
        if before.get(where) != value:
            layer, name = where
            raise ValueError(
                f"a module must keep what it remembers in buffers (register_buffer), got the "
                f"attribute {name} of {layer}"
            )


def _attributes(module: nn.Module) -> dict[tuple[str, str], object]:
    """Return the numbers that layers have as attributes; of tensors, which they are and how new."""
    return {
        (f"layer {place} ({type(layer).__name__})" if place else type(layer).__name__, name): (
            (id(value), value._version) if isinstance(value, Tensor) else value
        )
        for place, layer in module.named_modules()
        for name, value in vars(layer).items()
        if name not in OWN_ATTRIBUTES and isinstance(value, (Tensor, int, float))
    }
