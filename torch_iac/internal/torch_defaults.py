"""Keeps what a caller has set in torch as a whole away from the engine."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from threading import Lock
from typing import ParamSpec, TypeVar

import torch

Parameters = ParamSpec("Parameters")
"""What a function is called with, which stays the same."""

Result = TypeVar("Result")
"""What it returns."""

DTYPE, PRECISION = torch.float32, "highest"
"""Torch's own default type of real numbers, and how exact its matrix products are by default."""


def with_torch_defaults(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Let a function run with torch's own settings, whatever its caller has set.

    They are the default type and device, the precision of matrix products, no autocast and no
    inference mode. Gradients are on or off as before.
    """

    @wraps(function)
    def run(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        _process.enter()
        try:
            if _is_usual():
                return function(*args, **kwargs)
            is_grad = torch.is_grad_enabled()
            with ExitStack() as stack:
                stack.enter_context(torch.inference_mode(mode=False))
                stack.enter_context(torch.set_grad_enabled(is_grad))
                stack.enter_context(torch.device("cpu"))
                stack.enter_context(torch.autocast("cpu", enabled=False))
                if torch.is_autocast_enabled("cuda"):
                    stack.enter_context(torch.autocast("cuda", enabled=False))
                return function(*args, **kwargs)
        finally:
            _process.leave()

    return run


def _is_usual() -> bool:
    """Return whether this thread has no settings but torch's own."""
    # A tensor tells of two at once, in a tenth of the time of asking for each: 1 µs.
    sample = torch.empty(0)
    return (
        sample.device.type == "cpu"
        and not sample.is_inference()
        and not torch.is_autocast_enabled("cpu")
        and not torch.is_autocast_enabled("cuda")
    )


class _Process:
    """The settings that torch has once a process, for all threads.

    They are torch's own as long as any thread is in the engine, and the caller's again after.
    """

    def __init__(self) -> None:
        self._lock, self._n_inside = Lock(), 0
        self._dtype, self._precision = DTYPE, PRECISION

    def enter(self) -> None:
        with self._lock:
            if not self._n_inside:
                self._dtype = torch.get_default_dtype()
                self._precision = torch.get_float32_matmul_precision()
                self._set(DTYPE, PRECISION)
            self._n_inside += 1

    def leave(self) -> None:
        with self._lock:
            self._n_inside -= 1
            if not self._n_inside:
                self._set(self._dtype, self._precision)

    def _set(self, dtype: torch.dtype, precision: str) -> None:
        if self._dtype is not DTYPE:
            torch.set_default_dtype(dtype)
        if self._precision != PRECISION:
            torch.set_float32_matmul_precision(precision)


_process = _Process()
