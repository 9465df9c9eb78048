"""Loops compiled for the processor, which give the same bits on every x86-64 processor.

Each number comes from the same operations in the same order, whatever else is in the batch and
however many threads share it. Numba without `fastmath` neither reorders a sum nor fuses a product
with a sum, and nothing is left to the mathematical library of a vendor, which may round by the kind
of processor or by where in memory a matrix lies.

Shapes: `A` rows that are asked, of `L` that there are; `P` weights of a network; `B` examples in a
minibatch, of `M`; `U` numbers into a network and out of all its layers.
"""

import math
import os
from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any, TypeVar, cast

import numba
import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from torch_iac.internal.losses import SMALL_ERROR

Function = TypeVar("Function", bound=Callable[..., Any])
"""A compiled function keeps its type."""

LEAST_WORK = 200_000
"""Multiplications for which another thread pays: waking one costs about 20 µs."""

_MOST_THREADS: int = cast(Any, numba.config).NUMBA_NUM_THREADS
_threads = Lock()
"""Held while threads work together: not all of Numba's threading layers can be entered twice."""
_forked = False
"""Whether this process was forked: a fork does not have its parent's threads."""

_LEAST_POWER = -600
_POWERS = np.array([2.0**k for k in range(_LEAST_POWER, 601)])
_LOG_2_HIGH, _LOG_2_LOW = 0.693145751953125, 1.42860682030941723212e-6
_MEAN_RATE = np.float32(0.1)
_SQUARE_RATE, _SQUARE_KEPT = np.float32(0.001), np.float32(0.999)
_SMALL_SCALE = np.float32(1e-8)
_ZERO = np.float32(0.0)


def _compiled(function: Function, parallel: bool = False) -> Function:
    # error_model="numpy": a division by zero gives infinity, without a check in each loop.
    compiled: Any = njit(cache=True, nogil=True, error_model="numpy", parallel=parallel)(function)
    return cast(Function, compiled)


def _shared(function: Function) -> Function:
    """Compile a function whose `prange` is shared out over threads."""
    return _compiled(function, parallel=True)


def _note_fork() -> None:
    global _forked
    _forked = True


if hasattr(os, "register_at_fork"):  # Windows does not fork
    os.register_at_fork(after_in_child=_note_fork)


def exp(values: Tensor) -> Tensor:
    """Return e to the power of values of any shape, right to about one unit in the last place.

    On a GPU it is torch's own.
    """
    if values.device.type != "cpu":
        return values.exp()
    flat = values.double().contiguous().view(-1)
    powers = torch.empty_like(flat)
    _fill_exp(flat.numpy(), powers.numpy())
    return powers.view(values.shape).to(values.dtype)


def sqrt(values: Tensor) -> Tensor:
    """Return the square roots of values of any shape, correctly rounded.

    On a GPU they are torch's own.
    """
    if values.device.type != "cpu":
        return values.sqrt()
    return torch.from_numpy(np.sqrt(values.numpy()))  # torch uses the vendor's library


def squared_distances(situations: Tensor, rows: Tensor, points: Tensor) -> Tensor:
    """Return the squared Euclidean distance of a point to each situation of its row.

    In steps of `UNIT_STEP` all coordinates are whole numbers, so the sums are exact in float64, in
    whatever order they are taken.

    Args:
        situations: Shape `(L, D, N)`, float32, in the unit cube, or infinite where there is none.
        rows: Shape `(A,)`.
        points: Shape `(A, D)`, float32, in the unit cube.

    Returns:
        Shape `(A, N)`, float64.
    """
    if rows.device.type != "cpu":
        offsets = situations.index_select(0, rows).double().sub_(points[:, :, None])
        return offsets.square_().sum(dim=1)
    shape = (len(rows), situations.shape[2])
    distances = torch.empty(shape, dtype=torch.float64, device=rows.device)
    arrays = (_array(situations), _array(rows), _array(points), distances.numpy())
    functions = _fill_squared_distances, _share_squared_distances
    _call(functions, len(rows), situations[0].numel(), arrays)
    return distances


def perceptrons(weights: Tensor, rows: Tensor, sizes: Sequence[int], inputs: Tensor) -> Tensor:
    """Return the outputs of multi-layer perceptrons with ReLU.

    Args:
        weights: Shape `(L, P)`, float32, on the CPU: of each layer its matrix, then its biases.
        rows: Shape `(A,)`, which networks are asked.
        sizes: How many numbers go into each layer, and how many come out of the last.
        inputs: Shape `(A, B, sizes[0])`.

    Returns:
        Shape `(A, B, sizes[-1])`.
    """
    n_rows, n_inputs, _ = inputs.shape
    outputs = torch.empty(n_rows, sizes[-1], n_inputs, device=rows.device)
    arrays = (_array(weights), _array(rows), np.array(sizes), _array(inputs.mT), outputs.numpy())
    _call((_fill_outputs, _share_outputs), n_rows, n_inputs * weights.shape[1], arrays)
    return outputs.mT


def train_perceptrons(
    weights: Tensor,
    memory: Sequence[Tensor],
    rows: Tensor,
    sizes: Sequence[int],
    inputs: Tensor,
    targets: Tensor,
    minibatch_size: int,
    loss: int,
    optimizer: str,
    learning_rate: float,
    tiny: float,
) -> Tensor:
    """Take one step of the optimiser for each minibatch, in place.

    Args:
        weights: Shape `(L, P)`, as for `perceptrons`.
        memory: Adam's running means of gradients and of their squares, each `(L, P)`, and their
            bias corrections, `(L, 2)`.
        rows: Shape `(A,)`, different networks.
        sizes: As for `perceptrons`.
        inputs: Shape `(A, M * B, sizes[0])`.
        targets: Shape `(A, M * B, sizes[-1])`.
        minibatch_size: B.
        loss: Index of the loss in `losses.LOSSES`.
        optimizer: `adam` or `sgd`.
        learning_rate: Step size.
        tiny: Added to each gradient for Adam.

    Returns:
        Shape `(A,)`, the mean loss in the last minibatch, before its step.
    """
    losses = torch.empty(len(rows), device=rows.device)
    arrays = (
        *(_array(weights), *(_array(column) for column in memory), _array(rows), np.array(sizes)),
        *(_array(inputs.mT), _array(targets.mT), losses.numpy()),
    )
    numbers = (minibatch_size, loss, optimizer == "adam", np.float32(learning_rate))
    work = 3 * inputs.shape[1] * weights.shape[1]
    _call((_train, _share_training), len(rows), work, (*arrays, *numbers, np.float32(tiny)))
    return losses


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.contiguous().numpy()


def _call(
    functions: tuple[Callable[..., None], Callable[..., None]],
    n_rows: int,
    work: int,
    arguments: tuple[Any, ...],
) -> None:
    """Compute all rows on one thread, or on as many as torch uses where that pays.

    Numba's threads are OpenMP's, like torch's, where it finds the same OpenMP: a pool beside them
    would wait for the processor, as OpenMP's threads spin for milliseconds after each operation of
    torch (256 robots with networks made 7,800 decisions a second on two cores, and 11,300 so).

    Args:
        functions: One that computes rows from its first argument to its second, each by itself, and
            one that divides as many rows as its first argument into as many parts as its second.
        n_rows: A.
        work: About how many multiplications a row takes.
        arguments: The functions' other arguments.
    """
    alone, shared = functions
    n_threads = torch.get_num_threads()
    if _forked or min(n_threads, n_rows, n_rows * work // LEAST_WORK) < 2:
        alone(0, n_rows, *arguments)
        return
    with _threads:
        numba.set_num_threads(min(n_threads, _MOST_THREADS))
        shared(n_rows, n_threads, arguments)


@_compiled
def _exp(x: Any) -> Any:
    """Return e**x: 2**k times e**r with r = x - k log 2, by the Taylor series of e**r."""
    if x != x:
        return x
    x = min(max(x, -746.0), 710.0)
    k = math.floor(x * 1.4426950408889634 + 0.5)
    r = x - k * _LOG_2_HIGH - k * _LOG_2_LOW  # |r| is at most log(2) / 2
    series = 1.0
    for n in range(13, 0, -1):
        series = 1.0 + series * r / n
    half = k // 2  # 2**k itself may be too small or too large for a float64
    return series * _POWERS[half - _LEAST_POWER] * _POWERS[k - half - _LEAST_POWER]


@_compiled
def _fill_exp(values: np.ndarray, powers: np.ndarray) -> None:
    for i in range(len(values)):
        powers[i] = _exp(values[i])


@_compiled
def _fill_squared_distances(
    first: int,
    last: int,
    situations: np.ndarray,
    rows: np.ndarray,
    points: np.ndarray,
    distances: np.ndarray,
) -> None:
    for a in range(first, last):
        own, distance = situations[rows[a]], distances[a]
        distance[:] = 0.0
        for d in range(own.shape[0]):
            point, values = np.float64(points[a, d]), own[d]
            for n in range(len(values)):
                offset = np.float64(values[n]) - point
                distance[n] += offset * offset


@_shared
def _share_squared_distances(n_rows: int, n_parts: int, arguments: Any) -> None:
    for i in prange(n_parts):
        _fill_squared_distances(n_rows * i // n_parts, n_rows * (i + 1) // n_parts, *arguments)


@_compiled
def _add_products(sums: np.ndarray, factors: np.ndarray, rows: np.ndarray) -> None:
    """Add the matrix product of factors `(m, k)` and rows `(k, n)` to sums `(m, n)`.

    To each sum the products are added one after the other. Four sums at a time take turns, as the
    next product of one has to wait for the one before (16 to 23 products a nanosecond instead of 11
    to 17 with one sum at a time).
    """
    n_sums, n = sums.shape
    n_rows = len(rows)
    last = n_sums - n_sums % 4
    for m in range(0, last, 4):
        a, b, c, d = sums[m], sums[m + 1], sums[m + 2], sums[m + 3]
        for k in range(n_rows):
            f, g, h, i = factors[m, k], factors[m + 1, k], factors[m + 2, k], factors[m + 3, k]
            row = rows[k]
            for j in range(n):
                value = row[j]
                a[j] += f * value
                b[j] += g * value
                c[j] += h * value
                d[j] += i * value
    for m in range(last, n_sums):
        own = sums[m]
        for k in range(n_rows):
            factor, row = factors[m, k], rows[k]
            for j in range(n):
                own[j] += factor * row[j]


@_compiled
def _forward(weights: np.ndarray, sizes: np.ndarray, values: np.ndarray) -> None:
    """Fill in the outputs of each layer of a network.

    Args:
        weights: Shape `(P,)`.
        sizes: How many numbers go into each layer, and how many come out of the last.
        values: Shape `(U, B)`; the first `sizes[0]` rows are the inputs.
    """
    start, before = 0, 0
    for layer in range(len(sizes) - 1):
        n_in, n_out = sizes[layer], sizes[layer + 1]
        after = before + n_in
        biases = start + n_in * n_out
        matrix = weights[start:biases].reshape(n_out, n_in)
        outputs = values[after : after + n_out]
        for unit in range(n_out):
            outputs[unit] = weights[biases + unit]
        _add_products(outputs, matrix, values[before:after])
        if layer < len(sizes) - 2:
            for unit in range(n_out):
                output = outputs[unit]
                for j in range(len(output)):
                    output[j] = _ZERO if output[j] < _ZERO else output[j]  # keeps NaN
        start, before = biases + n_out, after


@_compiled
def _fill_outputs(
    first: int,
    last: int,
    weights: np.ndarray,
    rows: np.ndarray,
    sizes: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
) -> None:
    n_inputs, n_outputs = sizes[0], sizes[-1]
    values = np.empty((sizes.sum(), inputs.shape[2]), np.float32)
    for a in range(first, last):
        values[:n_inputs] = inputs[a]
        _forward(weights[rows[a]], sizes, values)
        outputs[a] = values[-n_outputs:]


@_shared
def _share_outputs(n_rows: int, n_parts: int, arguments: Any) -> None:
    for i in prange(n_parts):
        _fill_outputs(n_rows * i // n_parts, n_rows * (i + 1) // n_parts, *arguments)


@_compiled
def _fill_slopes(loss: int, outputs: np.ndarray, targets: np.ndarray, slopes: np.ndarray) -> float:
    """Fill in the gradient of a mean loss, all `(K, B)`, and return that loss."""
    total = 0.0
    n = np.float32(outputs.size)
    for k in range(outputs.shape[0]):
        for b in range(outputs.shape[1]):
            output, target = outputs[k, b], targets[k, b]
            if loss == 0:  # squared error
                difference = output - target
                total += np.float64(difference * difference)
                slopes[k, b] = np.float32(2) * difference / n
            else:  # of a gamma-distributed error
                ratio = (target + np.float32(SMALL_ERROR)) * np.float32(_exp(-np.float64(output)))
                total += np.float64(ratio + output)
                slopes[k, b] = (np.float32(1) - ratio) / n
    return total / outputs.size


@_compiled
def _backward(
    weights: np.ndarray,
    sizes: np.ndarray,
    values: np.ndarray,
    slopes: np.ndarray,
    room: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Fill in the gradient `(P,)` of a network.

    Args:
        weights: Shape `(P,)`.
        sizes: As for `_forward`.
        values: Shape `(U, B)`, what `_forward` filled in.
        slopes: Shape `(U, B)`; the last `sizes[-1]` rows are the gradient by the outputs.
        room: Shape `((B + largest layer) * largest layer,)`, for transposed matrices.
        gradient: Shape `(P,)`, filled in.
    """
    after, end = values.shape[0] - sizes[-1], len(weights)
    n_batch = values.shape[1]
    for layer in range(len(sizes) - 2, -1, -1):
        n_in, n_out = sizes[layer], sizes[layer + 1]
        before, biases = after - n_in, end - n_out
        start = biases - n_in * n_out
        inputs, by_outputs = values[before:after], slopes[after : after + n_out]
        turned = room[: n_batch * n_out].reshape(n_batch, n_out)
        turned[:] = by_outputs.T
        by_biases = gradient[biases:end]
        by_biases[:] = _ZERO
        for b in range(n_batch):
            by_biases += turned[b]
        by_weights = gradient[start:biases].reshape(n_out, n_in)
        if n_in < n_out:  # the longer side is the inner loop
            product = room[n_batch * n_out :][: n_in * n_out].reshape(n_in, n_out)
            product[:] = _ZERO
            _add_products(product, inputs, turned)
            by_weights[:] = product.T
        else:
            turned = room[: n_batch * n_in].reshape(n_batch, n_in)
            turned[:] = inputs.T
            by_weights[:] = _ZERO
            _add_products(by_weights, by_outputs, turned)
        if layer > 0:
            by_inputs = slopes[before:after]
            by_inputs[:] = _ZERO
            _add_products(by_inputs, weights[start:biases].reshape(n_out, n_in).T, by_outputs)
            for unit in range(n_in):
                by_input, value = by_inputs[unit], inputs[unit]
                for b in range(n_batch):
                    by_input[b] = by_input[b] if value[b] > _ZERO else _ZERO
        after, end = before, start


@_compiled
def _adam(
    weights: np.ndarray,
    gradient: np.ndarray,
    mean: np.ndarray,
    square: np.ndarray,
    filled: np.ndarray,
    rate: float,
    tiny: float,
) -> None:
    """Update weights `(P,)`, and Adam's state, by one step."""
    filled[0] += _MEAN_RATE * (np.float32(1) - filled[0])
    filled[1] += _SQUARE_RATE * (np.float32(1) - filled[1])
    for p in range(len(weights)):
        slope = gradient[p] + tiny
        mean[p] += _MEAN_RATE * (slope - mean[p])
        square[p] = _SQUARE_KEPT * square[p] + _SQUARE_RATE * (slope * slope)
        scale = (np.sqrt(square[p] / filled[1]) + _SMALL_SCALE) * filled[0]
        weights[p] -= rate * mean[p] / scale


@_compiled
def _train(
    first: int,
    last: int,
    weights: np.ndarray,
    means: np.ndarray,
    squares: np.ndarray,
    filled: np.ndarray,
    rows: np.ndarray,
    sizes: np.ndarray,
    inputs: np.ndarray,
    targets: np.ndarray,
    losses: np.ndarray,
    n_batch: int,
    loss: int,
    adam: bool,
    rate: float,
    tiny: float,
) -> None:
    n_inputs, n_outputs = sizes[0], sizes[-1]
    values = np.empty((sizes.sum(), n_batch), np.float32)
    slopes = np.empty_like(values)
    room = np.empty((n_batch + sizes.max()) * sizes.max(), np.float32)
    gradient = np.empty(weights.shape[1], np.float32)
    for a in range(first, last):
        own = weights[rows[a]]
        for start in range(0, inputs.shape[2], n_batch):
            values[:n_inputs] = inputs[a, :, start : start + n_batch]
            _forward(own, sizes, values)
            target = targets[a, :, start : start + n_batch]
            losses[a] = _fill_slopes(loss, values[-n_outputs:], target, slopes[-n_outputs:])
            _backward(own, sizes, values, slopes, room, gradient)
            if adam:
                row = rows[a]
                _adam(own, gradient, means[row], squares[row], filled[row], rate, tiny)
            else:
                for p in range(len(own)):
                    own[p] -= rate * gradient[p]


@_shared
def _share_training(n_rows: int, n_parts: int, arguments: Any) -> None:
    for i in prange(n_parts):
        _train(n_rows * i // n_parts, n_rows * (i + 1) // n_parts, *arguments)
