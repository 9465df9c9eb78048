import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torch_iac.internal.losses import SMALL_ERROR
from torch_iac.internal.losses import gamma_loss as loss
from torch_iac.meta_predictor import (
    ErrorExpectation,
    ImprovementPredictor,
    MetaPredictor,
    filled_bins,
)

CPU = torch.device("cpu")
SEEDS = range(8)
"""Eight robots at once, so that chance averages out."""


def uniform(step: int, *shape: int) -> Tensor:
    return torch.rand(len(SEEDS), *shape, generator=torch.Generator().manual_seed(step))


def live(meta: ErrorExpectation, mean_error: Any, start: int, n: int) -> None:
    """Let MP learn errors between 0 and twice their mean, which depends on the situation."""
    for step in range(start, start + n):
        situations = uniform(2 * step, 2)
        meta.learn(situations, 2 * uniform(2 * step + 1) * mean_error(situations), step)


def expected(meta: ErrorExpectation, low: float = 0.0, high: float = 1.0) -> float:
    """The mean expectation, over situations whose first value lies in between."""
    situations = uniform(10**6, 200, 2)
    situations[..., 0] = low + situations[..., 0] * (high - low)
    return meta.expect(situations).mean().item()


def test_small_errors_are_learnt_as_precisely_as_large_ones() -> None:
    meta = MetaPredictor().start(2, SEEDS, CPU)
    live(meta, lambda situations: torch.where(situations[:, 0] < 0.5, 0.002, 0.2), 0, 2000)
    assert expected(meta, 0.0, 0.4) == pytest.approx(0.002, rel=0.25)
    assert expected(meta, 0.6, 1.0) == pytest.approx(0.2, rel=0.25)


def test_a_sharp_edge_is_learnt_with_bins() -> None:
    def leak(bins: int) -> float:
        meta = MetaPredictor(bins=bins).start(2, SEEDS, CPU)
        live(meta, lambda situations: torch.where(situations[:, 0] > 0.45, 0.005, 0.1), 0, 2000)
        return expected(meta, 0.5, 0.6) / 0.005

    assert leak(bins=16) == pytest.approx(1, rel=0.4)
    assert leak(bins=1) > 2


def test_bins_fill_from_the_lowest_on() -> None:
    filled = filled_bins(torch.tensor([[0.0, 0.25], [0.375, 1.0]]), torch.arange(4))
    assert filled.tolist() == [
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        [1.0, 0.5, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0],
    ]


def test_one_bin_is_the_situation_itself() -> None:
    situations = uniform(0, 5, 3)
    assert torch.equal(filled_bins(situations, torch.arange(1)), situations)


def test_a_robot_alone_expects_the_same_to_the_bit() -> None:
    alone, together = (MetaPredictor().start(14, seeds, CPU) for seeds in ([3], SEEDS))
    for step in range(50):
        situations, errors = uniform(2 * step, 14), uniform(2 * step + 1)
        alone.learn(situations[3:4], errors[3:4], step)
        together.learn(situations, errors, step)
    for n_candidates in (1, 50):
        candidates = uniform(1, n_candidates, 14)
        assert torch.equal(alone.expect(candidates[3:4]), together.expect(candidates)[3:4])


@pytest.mark.parametrize("before", [0.0, 0.01, 0.3])
def test_errors_age(before: float) -> None:
    meta = MetaPredictor(memory=150, learning_rate=0.003).start(2, SEEDS, CPU)
    live(meta, lambda _: before, 0, 800)
    assert expected(meta) == pytest.approx(before, rel=0.25, abs=1e-3)
    live(meta, lambda _: 0.1, 800, 300)  # an error expected to be none can come back, too
    assert expected(meta) == pytest.approx(0.1, rel=0.25)


def test_only_what_is_in_memory_is_learnt_from() -> None:
    quick = MetaPredictor(hidden=(32, 32), bins=1, learning_rate=0.003, minibatch_size=8)
    remembering, forgetting = (
        replace(quick, memory=memory).start(2, SEEDS, CPU) for memory in (99, 1)
    )
    for meta in (remembering, forgetting):
        live(meta, lambda _: 0.2, 0, 30)
        for step in range(30, 90):  # the same at every decision: nothing else is in memory
            meta.learn(torch.full((len(SEEDS), 2), 0.5), torch.full((len(SEEDS),), 0.02), step)
    here = torch.full((len(SEEDS), 1, 2), 0.5)
    assert forgetting.expect(here).mean().item() == pytest.approx(0.02, rel=0.1)
    assert remembering.expect(here).mean().item() > 0.04


def test_the_loss_is_least_at_the_mean_error() -> None:
    errors = torch.tensor([0.0, 0.01, 0.02, 0.17])
    guesses = torch.linspace(0.03, 0.07, 41)
    losses = loss((guesses + SMALL_ERROR).log()[:, None], errors)[0].mean(1)
    assert guesses[losses.argmin()].item() == pytest.approx(0.05)


def test_the_loss_without_error_is_finite_and_has_a_least() -> None:
    outputs = torch.linspace(-20, 5, 251, requires_grad=True)
    losses, slopes = loss(outputs, torch.zeros(251))
    assert torch.equal(slopes, *torch.autograd.grad(losses.sum(), outputs))
    least = outputs[losses.argmin()].item()
    assert least == pytest.approx(math.log(SMALL_ERROR), abs=0.1)
    assert (slopes[outputs < least - 0.1] < 0).all()
    assert (slopes[outputs > least + 0.1] > 0).all()


@given(st.lists(st.floats(0, 1, width=32), min_size=1, max_size=20), st.integers(0, 2**31))
def test_what_is_expected_is_an_error(errors: list[float], seed: int) -> None:
    meta = MetaPredictor(hidden=(4,), minibatches=2, learning_rate=0.1).start(2, [seed], CPU)
    for step, error in enumerate(errors):
        meta.learn(uniform(step, 2)[:1], torch.tensor([error], dtype=torch.float64), step)
        answers = meta.expect(uniform(step, 50, 2)[:1] * 3 - 1)  # outside the unit cube, too
        assert ((answers >= 0) & (answers <= 1)).all()


def test_to_ask_changes_nothing() -> None:
    one, other = (MetaPredictor().start(2, SEEDS, CPU) for _ in range(2))
    situations = uniform(0, 5, 2)
    before = situations.clone()
    assert torch.equal(one.expect(situations), one.expect(situations))
    assert torch.equal(situations, before)
    live(one, lambda _: 0.1, 0, 3)
    live(other, lambda _: 0.1, 0, 3)
    assert torch.equal(one.expect(situations), other.expect(situations))


def test_improvement_is_learnt_below_nothing_too() -> None:
    improvement = ImprovementPredictor().start(2, SEEDS, CPU)
    for step in range(500):
        situations = uniform(2 * step, 2)
        gains = torch.where(situations[:, 0] < 0.5, -0.1, 0.3) + 0.2 * (uniform(2 * step + 1) - 0.5)
        improvement.learn(situations, gains, step)
    left, right = uniform(1, 100, 2), uniform(2, 100, 2)
    left[..., 0] *= 0.4
    right[..., 0] = 0.6 + 0.4 * right[..., 0]
    assert improvement.predict(left).mean().item() == pytest.approx(-0.1, abs=0.03)
    assert improvement.predict(right).mean().item() == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("kind", [MetaPredictor, ImprovementPredictor])
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"memory": 0}, "memory must be at least 1, got 0"),
        ({"bins": 0}, "bins must be at least 1, got 0"),
        ({"hidden": (8, 0)}, r"hidden must be at least 1 unit a layer, got \(8, 0\)"),
        ({"minibatches": 0}, "minibatches must be at least 1, got 0"),
    ],
)
def test_bad_numbers_are_refused(kind: Any, values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**values)
