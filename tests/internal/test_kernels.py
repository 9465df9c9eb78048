import math
import multiprocessing
import warnings
from collections.abc import Iterator
from itertools import pairwise, product

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from tests.golden import check_company, learnt
from torch_iac.experts.mlp import MLP
from torch_iac.experts.stacked_networks import TINY, StackedNetworks, Training
from torch_iac.internal import kernels
from torch_iac.internal.losses import LOSSES, Loss
from torch_iac.internal.scaling import UNIT_STEP


@pytest.fixture
def threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@given(st.floats(-800, 800))
def test_exp_is_within_one_unit_in_the_last_place(x: float) -> None:
    (power,) = kernels.exp(torch.tensor([x], dtype=torch.float64)).tolist()
    try:
        expected = math.exp(x)
    except OverflowError:
        expected = math.inf
    assert power == expected or abs(power - expected) <= 1.5 * math.ulp(expected)


@pytest.mark.parametrize("x", [0.0, -0.0, math.inf, -math.inf, math.nan, -745.0, 709.78])
def test_exp_of_special_numbers(x: float) -> None:
    (power,) = kernels.exp(torch.tensor([x], dtype=torch.float64)).tolist()
    assert power == pytest.approx(math.exp(x), rel=1e-15, nan_ok=True)


def test_exp_keeps_shape_and_type() -> None:
    values = torch.linspace(-3, 3, 12).view(3, 4).mT
    powers = kernels.exp(values)
    assert powers.dtype == torch.float32
    torch.testing.assert_close(powers, values.exp(), rtol=1e-6, atol=0.0)


def test_square_roots_are_rounded_correctly() -> None:
    values = torch.rand(1000, generator=torch.Generator().manual_seed(0))
    exact = [np.float32(math.sqrt(value)) for value in values.tolist()]
    assert kernels.sqrt(values).tolist() == exact


@pytest.mark.usefixtures("threads")
@pytest.mark.parametrize("n_threads", [1, 3])
def test_squared_distances_are_exact(n_threads: int) -> None:
    torch.set_num_threads(n_threads)
    generator = torch.Generator().manual_seed(0)
    steps = torch.randint(0, round(1 / UNIT_STEP) + 1, (700, 14, 51), generator=generator)
    points = torch.randint(0, round(1 / UNIT_STEP) + 1, (900, 14), generator=generator)
    rows = torch.randint(0, 700, (900,), generator=generator)
    # Whole numbers of up to 2**46, and so their sums, are exact in 64 bits.
    exact = (steps[rows] - points[:, :, None]).square().sum(dim=1)
    distances = kernels.squared_distances(
        steps.float() * UNIT_STEP, rows, points.float() * UNIT_STEP
    )
    assert torch.equal(distances / UNIT_STEP**2, exact.double())


def test_an_absent_example_is_infinitely_far() -> None:
    situations = torch.tensor([[[0.25, math.inf]]])
    distances = kernels.squared_distances(situations, torch.tensor([0]), torch.tensor([[0.5]]))
    assert distances.tolist() == [[0.0625, math.inf]]


def stack(n_rows: int, sizes: list[int]) -> tuple[Tensor, list[Tensor]]:
    """Random weights, and what an optimiser remembers before its first step."""
    n_weights = sum((n_in + 1) * n_out for n_in, n_out in pairwise(sizes))
    weights = torch.rand(n_rows, n_weights, generator=torch.Generator().manual_seed(2)) - 0.5
    return weights, [torch.zeros(n_rows, n) for n in (n_weights, n_weights, 2)]


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
@pytest.mark.parametrize("sizes", [[3, 2], [14, 7, 1], [7, 32, 32, 3], [1, 1, 5, 1]])
def test_perceptrons_learn_as_with_torchs_own_optimiser(
    sizes: list[int], optimizer: str, loss: Loss
) -> None:
    generator = torch.Generator().manual_seed(1)
    inputs, targets = (torch.rand(2, 21, n, generator=generator) for n in (sizes[0], sizes[-1]))
    weights, memory = stack(4, sizes)
    module = MLP(tuple(sizes[1:-1]))(sizes[0], sizes[-1]).double()
    nn.utils.vector_to_parameters(weights[3].double(), module.parameters())
    kind = {"adam": torch.optim.Adam, "sgd": torch.optim.SGD}[optimizer]
    optimiser = kind(module.parameters(), lr=0.02)
    for start in range(0, 21, 7):
        optimiser.zero_grad()
        outputs = module(inputs[1, start : start + 7].double())
        values, slopes = loss(outputs.detach(), targets[1, start : start + 7].double())
        outputs.backward(slopes / slopes.numel())
        optimiser.step()
    losses = kernels.train_perceptrons(
        *(weights, memory, torch.tensor([0, 3]), sizes, inputs, targets, 7),
        *(LOSSES.index(loss), optimizer, 0.02, TINY),
    )
    assert losses[1].item() == pytest.approx(values.mean().item(), rel=1e-4)
    expected = nn.utils.parameters_to_vector(module.parameters()).detach().float()
    torch.testing.assert_close(weights[3], expected, rtol=1e-4, atol=1e-5)
    answers = kernels.perceptrons(weights, torch.tensor([3]), sizes, inputs[1:])
    torch.testing.assert_close(answers[0], module(inputs[1].double()).float().detach())


SHAPES = [(2, 7, 32), (3, 14, 32), (7, 14, 7), (2, 32, 7), (1, 14, 32), (5, 9, 1)]
"""Batches, inputs and outputs for which vendors' products round by where matrices lie."""


@pytest.mark.parametrize(("n_batch", "n_in", "n_out"), SHAPES)
def test_a_product_does_not_depend_on_company_nor_on_where_it_lies(
    n_batch: int, n_in: int, n_out: int
) -> None:
    sizes, n_rows = [n_in, n_out], 40
    weights, _ = stack(n_rows, sizes)
    inputs = torch.rand(n_rows, n_batch, n_in, generator=torch.Generator().manual_seed(0))
    together = kernels.perceptrons(weights, torch.arange(n_rows), sizes, inputs)
    for first, n_asked, offset in product((0, 1, 17), (1, 2, 23), (0, 1, 3)):
        rows = torch.arange(first, first + n_asked)
        elsewhere = torch.empty(weights.numel() + offset)[offset:].view_as(weights)
        elsewhere.copy_(weights)
        some = kernels.perceptrons(elsewhere, rows, sizes, inputs[rows])
        assert torch.equal(some, together[rows])


def test_a_weight_that_is_no_number_shows() -> None:
    weights, _ = stack(1, [2, 3, 1])
    weights[0, 0] = math.nan
    answers = kernels.perceptrons(weights, torch.tensor([0]), [2, 3, 1], torch.ones(1, 1, 2))
    assert answers.isnan().all()


@pytest.mark.usefixtures("threads")
def test_a_forked_process_can_go_on() -> None:
    torch.set_num_threads(2)
    situations = torch.rand(100, 14, 500, generator=torch.Generator().manual_seed(0))
    rows, points = torch.arange(100), situations[:, :, 0].contiguous()
    expected = kernels.squared_distances(situations, rows, points)
    received, sent = multiprocessing.Pipe(duplex=False)

    def answer() -> None:
        sent.send(kernels.squared_distances(situations, rows, points).numpy())

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forking where there are threads
        process = multiprocessing.get_context("fork").Process(target=answer)
        process.start()
    assert received.poll(timeout=900)
    assert np.array_equal(received.recv(), expected.numpy())
    process.join()


@pytest.mark.usefixtures("threads")
def test_threads_change_nothing() -> None:
    torch.set_num_threads(1)
    alone = learnt(range(40))
    for n_threads in (2, 5):
        torch.set_num_threads(n_threads)
        assert all(map(torch.equal, learnt(range(40)), alone))


def test_company_changes_nothing() -> None:
    check_company()


def test_a_plain_sequence_of_other_layers_takes_the_other_way() -> None:
    def tanh(n_inputs: int, n_outputs: int) -> nn.Module:
        return nn.Sequential(nn.Linear(n_inputs, 3), nn.Tanh(), nn.Linear(3, n_outputs))

    def compiled(factory: object) -> list[int]:
        networks = StackedNetworks(factory, 2, 1, Training(), torch.device("cpu"))  # type: ignore[arg-type]
        return networks._perceptron

    assert compiled(tanh) == []
    assert compiled(MLP((4, 5))) == [2, 4, 5, 1]
    assert compiled(MLP(())) == [2, 1]
