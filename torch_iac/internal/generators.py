"""Random numbers of torch from a generator of one's own, also where code names none."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

GENERATOR = "generator"
"""The argument by which torch's functions take a generator."""

_COMPOSED = tuple(
    getattr(torch.ops.aten, name).default
    for name in ("dropout", "feature_dropout", "alpha_dropout", "feature_alpha_dropout")
)


def generator_of(key: int | Sequence[int], device: torch.device | str = "cpu") -> torch.Generator:
    """Return a generator of its own for each key, whole numbers that are not negative."""
    # torch on the CPU uses only 32 bits of a seed, so all bits of the key are mixed into these.
    mixed = np.random.SeedSequence(key).generate_state(1).item()
    return torch.Generator(device).manual_seed(mixed)


class DrawnFrom(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """A context in which torch draws from a generator, not from the one that all threads share.

    It holds for the thread that enters it. Layers that draw, such as `nn.Dropout`, and the usual
    initial weights of layers are drawn from it too.

    Args:
        generator: The generator; it must be on the device of what is drawn. With None nothing may
            be drawn.
    """

    def __init__(self, generator: torch.Generator | None) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._generator = generator

    def __torch_dispatch__(
        self,
        func: Any,
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        """Carry out an operation of torch.

        Raises:
            ValueError: It draws, and must not or takes no generator.
        """
        named = dict(kwargs or {})
        if torch.Tag.nondeterministic_seeded not in func.tags:
            return func(*args, **named)
        if func in _COMPOSED:  # seen whole in inference mode only; its parts draw, or do not
            with self:
                return func.decompose(*args, **named)
        if self._generator is None:
            raise ValueError("random numbers must be drawn in train mode only (self.training)")
        if func is torch.ops.aten.native_dropout.default:  # what a GPU does for `nn.Dropout`
            return self._dropout(*args, **named)
        drawing = _with_generator(func)
        return drawing(*args, **{**named, GENERATOR: self._generator})

    def _dropout(self, inputs: Tensor, rate: float, is_training: bool | None) -> Any:
        kept = torch.ones_like(inputs, dtype=torch.bool)
        if is_training is False:
            return inputs.clone(), kept
        kept.bernoulli_(1 - rate, generator=self._generator)
        return inputs * kept * (0.0 if rate == 1 else 1 / (1 - rate)), kept


def _with_generator(func: Any) -> Callable[..., Any]:
    """Return the same operation with a generator as an argument.

    Raises:
        ValueError: There is none.
    """
    wanted = [*_arguments(func), GENERATOR]
    packet = func.overloadpacket
    for other in (func, *(getattr(packet, name) for name in packet.overloads())):
        names = _arguments(other)
        if GENERATOR in names and sorted({*names, GENERATOR}) == sorted({*wanted}):
            found: Callable[..., Any] = other
            return found
    raise ValueError(f"random numbers must come from a generator, which {func} does not take")


def _arguments(func: Any) -> list[str]:
    return [argument.name for argument in func._schema.arguments]
