import random
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from torch_iac.experts.mlp import MLP
from torch_iac.experts.modules import Factory
from torch_iac.experts.stacked_networks import StackedNetworks, Training
from torch_iac.internal.losses import squared_error

CPU = torch.device("cpu")
N_INPUTS, N_OUTPUTS, SIZE = 3, 2, 8
INPUTS = torch.rand(5, 4 * SIZE, N_INPUTS, generator=torch.Generator().manual_seed(1))
TARGETS = torch.stack([INPUTS.sum(2) / 3, INPUTS[..., 0] * INPUTS[..., 1]], dim=2)


class Plain(nn.Module):
    """What `MLP((4,))` makes, as a module of one's own."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.hidden, self.out = nn.Linear(n_inputs, 4), nn.Linear(4, n_outputs)

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.out(self.hidden(inputs).relu())
        return outputs


def unbiased(n_inputs: int, n_outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(n_inputs, n_outputs, bias=False), nn.Tanh())


def nested(n_inputs: int, n_outputs: int) -> nn.Module:
    return nn.Sequential(MLP((4,))(n_inputs, 6), nn.LayerNorm(6), nn.Linear(6, n_outputs))


def smooth(n_inputs: int, n_outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(n_inputs, 4), nn.Tanh(), nn.Linear(4, n_outputs), nn.Sigmoid())


def shared(n_inputs: int, n_outputs: int) -> nn.Module:
    """One layer object in two places, a function and then weights."""
    act, hidden = nn.Tanh(), nn.Linear(4, 4)
    first, last = nn.Linear(n_inputs, 4), nn.Linear(4, n_outputs)
    return nn.Sequential(first, act, hidden, act, hidden, act, last)


def repeated(n_inputs: int, n_outputs: int) -> nn.Module:
    act = nn.ReLU()
    return nn.Sequential(nn.Linear(n_inputs, 4), act, nn.Linear(4, n_outputs), act)


FACTORIES: list[Factory] = [
    *(MLP(()), MLP((4,)), MLP((7, 1)), Plain),
    *(smooth, unbiased, nested, shared, repeated),
]


def stack(factory: Factory, n_rows: int = 5, **values: Any) -> StackedNetworks:
    """Networks in the first rows, made from seeds 10, 11, ..."""
    networks = StackedNetworks(factory, N_INPUTS, N_OUTPUTS, Training(**values), CPU)
    networks.reserve(n_rows)
    networks.start(torch.arange(n_rows), range(10, 10 + n_rows))
    return networks


def train(networks: StackedNetworks, rows: list[int], n_times: int = 1) -> Tensor:
    losses = torch.empty(0)
    for _ in range(n_times):
        losses = networks.train(
            torch.tensor(rows), INPUTS[rows], TARGETS[rows], SIZE, squared_error
        )
    return losses


def answers(networks: StackedNetworks, rows: list[int]) -> Tensor:
    return networks.predict(torch.tensor(rows), INPUTS[0].expand(len(rows), -1, -1))


@pytest.mark.parametrize("factory", FACTORIES)
def test_each_row_answers_as_its_module_does_alone(factory: Factory) -> None:
    rows = [3, 0, 4]
    networks = stack(factory)
    together = networks.predict(torch.tensor(rows), INPUTS[rows])
    for row, outputs in zip(rows, together, strict=True):
        alone = networks._module.made(10 + row)(INPUTS[row])
        torch.testing.assert_close(outputs, alone, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
@pytest.mark.parametrize("factory", FACTORIES)
def test_training_is_torchs_own_optimiser(factory: Factory, optimizer: str) -> None:
    networks = stack(factory, optimizer=optimizer, learning_rate=0.02)
    module = networks._module.made(12)
    kind = {"adam": torch.optim.Adam, "sgd": torch.optim.SGD}[optimizer]
    optimiser = kind(module.parameters(), lr=0.02)
    batches = [part[2].view(-1, SIZE, part.shape[2]) for part in (INPUTS, TARGETS)]
    for _ in range(10):
        last = train(networks, [0, 2, 3])[1]
        for inputs, targets in zip(*batches, strict=True):
            optimiser.zero_grad()
            loss = nn.functional.mse_loss(module(inputs), targets)
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        assert last.item() == pytest.approx(loss.item(), rel=1e-3)
    torch.testing.assert_close(
        answers(networks, [2])[0], module(INPUTS[0]).detach(), rtol=1e-4, atol=1e-5
    )


def test_layers_in_a_row_and_a_module_of_ones_own_learn_the_same() -> None:
    layers, own = stack(MLP((4,))), stack(Plain)
    torch.testing.assert_close(
        train(layers, [0, 1, 2], 20), train(own, [0, 1, 2], 20), rtol=1e-3, atol=1e-6
    )
    torch.testing.assert_close(
        answers(layers, [0, 1, 2]), answers(own, [0, 1, 2]), rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
@pytest.mark.parametrize("hidden", [(), (1,), (8,), (32, 32)])
@pytest.mark.parametrize(("n_inputs", "n_outputs"), [(1, 1), (4, 1), (7, 3)])
def test_company_changes_nothing_to_the_bit(
    n_inputs: int, n_outputs: int, hidden: tuple[int, ...], optimizer: Any
) -> None:
    generator = torch.Generator().manual_seed(0)
    inputs = torch.rand(40, 64, n_inputs, generator=generator)
    targets = torch.rand(40, 64, n_outputs, generator=generator)

    def life(rows: list[int]) -> tuple[Tensor, Tensor]:
        networks = StackedNetworks(
            MLP(hidden), n_inputs, n_outputs, Training(optimizer=optimizer), CPU
        )
        networks.reserve(40)
        networks.start(torch.arange(40), range(40))
        these = torch.tensor(rows)
        for _ in range(5):
            losses = networks.train(these, inputs[these], targets[these], 32, squared_error)
        return losses, networks.predict(these, inputs[these, :9])

    losses, outputs = life(list(range(40)))
    for rows in ([0], [39], [3, 17]):
        alone = life(rows)
        assert torch.equal(alone[0], losses[rows])
        assert torch.equal(alone[1], outputs[rows])


@pytest.mark.parametrize("factory", [MLP((16,)), smooth])
def test_what_can_be_learnt_is_learnt(factory: Factory) -> None:
    networks = stack(factory)
    first, last = train(networks, [0, 1, 2, 3, 4]), train(networks, [0, 1, 2, 3, 4], 300)
    assert (first > 0.01).all()
    assert (last < 0.004).all()


def test_training_a_row_leaves_the_others_alone() -> None:
    networks, others = stack(MLP()), [0, 2, 3, 4]
    before, changed = answers(networks, others), answers(networks, [1])
    train(networks, [1], 3)
    assert torch.equal(answers(networks, others), before)
    assert not torch.equal(answers(networks, [1]), changed)
    untouched = stack(MLP())  # nor does the optimiser remember anything of it
    assert torch.equal(train(networks, others, 2), train(untouched, others, 2))


def test_a_copy_has_the_weights_and_what_the_optimiser_remembers() -> None:
    networks = stack(MLP())
    train(networks, [0], 3)
    networks.copy(torch.tensor([0]), torch.tensor([1]))
    assert torch.equal(*answers(networks, [0, 1]))
    twins = (INPUTS[:1].expand(2, -1, -1), TARGETS[:1].expand(2, -1, -1))
    for _ in range(3):
        one, other = networks.train(torch.tensor([0, 1]), *twins, SIZE, squared_error)
        assert one == other
    assert torch.equal(*answers(networks, [0, 1]))
    original = answers(networks, [0])
    train(networks, [1])
    assert torch.equal(answers(networks, [0]), original)


def test_to_start_a_row_again_is_to_forget() -> None:
    networks, fresh = stack(MLP()), stack(MLP())
    train(networks, [0, 1], 3)
    networks.start(torch.tensor([1]), [11])
    assert torch.equal(train(networks, [1], 3), train(fresh, [1], 3))
    assert torch.equal(answers(networks, [1]), answers(fresh, [1]))


def test_more_room_keeps_what_is_there() -> None:
    networks, same = stack(MLP()), stack(MLP())
    train(networks, [4], 3)
    train(same, [4], 3)
    networks.reserve(50)
    assert torch.equal(answers(networks, [0, 4]), answers(same, [0, 4]))
    assert torch.equal(train(networks, [4], 3), train(same, [4], 3))
    networks.start(torch.tensor([49]), [10])
    assert torch.equal(*answers(networks, [0, 49]))


def test_seeds_of_any_size_make_their_own_weights() -> None:
    networks, seeds = stack(MLP()), [0, -1, 2**32, 2**62, 2**70 + 3]
    networks.start(torch.arange(5), seeds)
    assert len({tuple(row.flatten().tolist()) for row in answers(networks, [0, 1, 2, 3, 4])}) == 5
    networks.start(torch.tensor([0]), [-1])
    assert torch.equal(*answers(networks, [0, 1]))


def test_making_and_training_networks_draws_nothing_from_torchs_own_generator() -> None:
    before = torch.random.get_rng_state()
    train(stack(nested), [0, 1])
    assert torch.equal(torch.random.get_rng_state(), before)


def test_the_module_is_asked_as_in_use_not_as_in_training() -> None:
    def forgetful(n_inputs: int, n_outputs: int) -> nn.Module:
        return nn.Sequential(nn.Dropout(0.5), nn.Linear(n_inputs, n_outputs))

    networks = stack(forgetful)
    assert torch.equal(answers(networks, [0]), answers(networks, [0]))


class Idle(Plain):
    """A module with weights that it does not use."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__(n_inputs, n_outputs)
        self.unused = nn.Linear(2, 2)


@pytest.mark.parametrize("rows", [[0], [0, 1]])
def test_weights_that_are_not_used_do_no_harm(rows: list[int]) -> None:
    first, last = train(stack(Idle), rows), train(stack(Idle), rows, 200)
    assert (last < first).all()


def weightless(n_inputs: int, n_outputs: int) -> nn.Module:  # noqa: ARG001
    return nn.ReLU()


def too_wide(n_inputs: int, n_outputs: int) -> nn.Module:
    return nn.Linear(n_inputs, n_outputs + 1)


def squeezed(n_inputs: int, n_outputs: int) -> nn.Module:  # noqa: ARG001
    return nn.Sequential(nn.Linear(n_inputs, 1), nn.Flatten(0))


def capricious(n_inputs: int, n_outputs: int) -> nn.Module:
    layer = nn.Linear(n_inputs, n_outputs)
    nn.init.constant_(layer.weight, random.random())
    return layer


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        (weightless, "a module must have weights to learn, got none"),
        (
            too_wide,
            r"a module must turn situations \(n, 3\) into outcomes \(n, 2\), "
            r"got \(2, 3\) for n = 2",
        ),
        (squeezed, r"into outcomes \(n, 2\), got \(2,\) for n = 2"),
        (capricious, "a module's factory must make the same weights from the same seed"),
    ],
)
def test_bad_modules_are_refused(factory: Factory, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StackedNetworks(factory, N_INPUTS, N_OUTPUTS, Training(), CPU)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"learning_rate": 0.0}, "learning_rate must be above 0, got 0.0"),
        ({"learning_rate": float("inf")}, "learning_rate must be above 0, got inf"),
        ({"learning_rate": 1e300}, r"learning_rate must be at most 1e\+38, got 1e\+300"),
        ({"learning_rate": float("nan")}, "learning_rate must be above 0, got nan"),
        ({"minibatches": 0}, "minibatches must be at least 1, got 0"),
        ({"minibatch_size": -2}, "minibatch_size must be at least 1, got -2"),
        ({"optimizer": "lion"}, "optimizer must be adam or sgd, got lion"),
    ],
)
def test_bad_training_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Training(**values)


def test_layers_need_units() -> None:
    with pytest.raises(ValueError, match=r"hidden must be at least 1 unit a layer, got \(4, 0\)"):
        MLP((4, 0))
