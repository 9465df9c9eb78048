"""Inside `DrawnFrom` torch draws from the generator that it is given, and from no other."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from threading import Thread

import pytest
import torch
from torch import Tensor, nn

from torch_iac.internal.generators import DrawnFrom

LAYERS = nn.Sequential(
    nn.Dropout(0.5), nn.AlphaDropout(0.5), nn.Dropout1d(0.5), nn.FeatureAlphaDropout(0.5)
)
MODES: list[Callable[[], AbstractContextManager[object]]] = [
    torch.enable_grad,
    torch.no_grad,
    torch.inference_mode,
]
DRAWS: list[Callable[[], Tensor]] = [
    lambda: torch.rand(3),
    lambda: torch.randn(2, 2),
    lambda: torch.randint(9, (4,)),
    lambda: torch.randperm(5),
    lambda: torch.rand_like(torch.ones(3)),
    lambda: torch.normal(torch.zeros(3), 1.0),
    lambda: torch.bernoulli(torch.full((9,), 0.5)),
    lambda: torch.multinomial(torch.ones(5), 3),
    lambda: torch.empty(3).exponential_(),
    lambda: nn.init.orthogonal_(torch.empty(3, 3)),
    lambda: torch.distributions.Normal(0.0, 1.0).sample(),  # type: ignore[no-untyped-call]
    lambda: nn.Linear(3, 3).weight.detach(),
]


def generator(seed: int = 1) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("draw", DRAWS)
def test_what_is_drawn_is_the_generators(draw: Callable[[], Tensor]) -> None:
    before = torch.get_rng_state()
    with DrawnFrom(generator()):
        one = draw()
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(1)
    assert torch.equal(one, draw())  # the same numbers as torch's own generator draws
    with DrawnFrom(generator(2)):
        assert not torch.equal(one, draw()) or one.dtype == torch.int64


@pytest.mark.parametrize("mode", MODES)
def test_layers_draw_from_it_when_they_learn(
    mode: Callable[[], AbstractContextManager[object]],
) -> None:
    with mode():
        LAYERS.train()
        with DrawnFrom(generator()):
            one = LAYERS(torch.ones(2, 8))
        torch.rand(5)
        with DrawnFrom(generator()):
            assert torch.equal(LAYERS(torch.ones(2, 8)), one)
        LAYERS.eval()
        with DrawnFrom(None):
            assert torch.equal(LAYERS(torch.ones(2, 8)), torch.ones(2, 8))


def test_without_a_generator_nothing_may_be_drawn() -> None:
    with DrawnFrom(None), pytest.raises(ValueError, match="drawn in train mode only"):
        torch.rand(1)


def test_other_threads_are_left_alone() -> None:
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    found: list[Tensor] = []
    with DrawnFrom(generator()):
        thread = Thread(target=lambda: found.append(torch.rand(4)))
        thread.start()
        thread.join()
    assert torch.equal(found[0], expected)
