"""Modules of a user's own: all that torch lets them do is done, a row a region, or refused."""

from collections.abc import Callable
from threading import Thread
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from torch_iac import IAC, Dimension, IACConfig, NetworkExperts, SensorimotorSpace
from torch_iac.experts.modules import Factory
from torch_iac.experts.stacked_networks import StackedNetworks, Training
from torch_iac.internal.losses import squared_error
from torch_iac.internal.state import State

CPU = torch.device("cpu")
PUSH, PLACE = Dimension("push", -1.0, 1.0), Dimension("place", 0.0, 1.0)
SPACE = SensorimotorSpace((PUSH,), (PLACE,), (PLACE,))
SIZE = 8


class RunningMean(nn.Module):
    """Adds the mean of all outputs so far, which it keeps in a buffer, and counts them."""

    mean: Tensor
    n_seen: Tensor

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(n_inputs, n_outputs)
        self.register_buffer("mean", torch.zeros(n_outputs))
        self.register_buffer("n_seen", torch.tensor(0))

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.linear(inputs)
        self.mean = 0.9 * self.mean + 0.1 * outputs.detach().mean(0)
        self.n_seen += len(inputs)
        return outputs + self.mean


class Tied(nn.Module):
    """Two layers with one matrix."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(n_inputs, n_inputs), nn.Linear(n_inputs, n_inputs)
        self.second.weight = self.first.weight
        self.last = nn.Linear(n_inputs, n_outputs)

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.last(self.second(self.first(inputs).tanh()).tanh())
        return outputs


class Choosy(nn.Module):
    """Does other things with large numbers than with small ones."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(n_inputs, n_outputs)

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.linear(inputs)
        return outputs if outputs.mean() > 0 else 2 * outputs


class Noisy(nn.Module):
    """Adds noise while it learns."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(n_inputs, n_outputs)

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.linear(inputs)
        return outputs + 0.1 * torch.randn_like(outputs) if self.training else outputs


def dropping(n_inputs: int, n_outputs: int, rate: float = 0.5) -> nn.Module:
    return nn.Sequential(
        nn.Linear(n_inputs, 16), nn.ReLU(), nn.Dropout(rate), nn.Linear(16, n_outputs)
    )


def undropped(n_inputs: int, n_outputs: int) -> nn.Module:
    return dropping(n_inputs, n_outputs, rate=0.0)


def normalising(n_inputs: int, n_outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(n_inputs, 4), nn.BatchNorm1d(4), nn.Linear(4, n_outputs))


def half_frozen(n_inputs: int, n_outputs: int) -> nn.Module:
    layers = nn.Sequential(nn.Linear(n_inputs, 4), nn.ReLU(), nn.Linear(4, n_outputs))
    layers[0].requires_grad_(False)
    return layers


def tied_layers(n_inputs: int, n_outputs: int) -> nn.Module:
    first, second = nn.Linear(n_inputs, n_inputs), nn.Linear(n_inputs, n_inputs)
    second.weight = first.weight
    return nn.Sequential(first, nn.ReLU(), second, nn.ReLU(), nn.Linear(n_inputs, n_outputs))


def hooked(n_inputs: int, n_outputs: int) -> nn.Module:
    """A layer that is changed by a hook, which the layer itself does not show."""
    layers = nn.Sequential(nn.Linear(n_inputs, 4), nn.ReLU(), nn.Linear(4, n_outputs))
    layers[0].register_forward_hook(lambda _, __, outputs: outputs + 1)
    return layers


def spectral(n_inputs: int, n_outputs: int) -> nn.Module:
    """A layer with a parametrisation that has buffers and renews them while it learns."""
    return nn.Sequential(
        nn.utils.parametrizations.spectral_norm(nn.Linear(n_inputs, 4)),
        nn.ReLU(),
        nn.Linear(4, n_outputs),
    )


def recurrent(n_inputs: int, n_outputs: int) -> nn.Module:
    class LastState(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.cell, self.out = nn.GRU(1, 4, batch_first=True), nn.Linear(4, n_outputs)

        def forward(self, inputs: Tensor) -> Tensor:
            outputs: Tensor = self.out(self.cell(inputs[..., None])[0][:, -1])
            return outputs

    assert n_inputs
    return LastState()


ALL: list[Factory] = [
    *(RunningMean, Tied, Choosy, Noisy, dropping, normalising, half_frozen, tied_layers, hooked),
    *(spectral, recurrent),
]


def life(
    factory: Factory, seeds: list[int], n_decisions: int = 60, population: IAC | None = None
) -> tuple[IAC, Tensor]:
    """Return robots in a simple world after some decisions, and their predictions `(T, A, K)`."""
    experts = NetworkExperts(module=factory, minibatches=2, minibatch_size=SIZE)
    config = IACConfig(experts=experts, meta=None, max_examples=20, window=5, delay=5)
    agent = population or IAC(SPACE, config, seeds)
    predictions = []
    places = torch.full((len(seeds), 1), 0.5)
    for _ in range(n_decisions):
        pushes = agent.act(places)
        places = (pushes.cos() * places).clamp(0, 1)
        predictions.append(agent.observe(places).predictions)
    return agent, torch.stack(predictions)


def assert_same(one: State, other: State) -> None:
    for name, tensor in one.items():
        assert torch.equal(tensor.nan_to_num(), other[name].nan_to_num()), name


@pytest.mark.parametrize("factory", ALL)
def test_any_module_is_the_same_alone_as_in_company(factory: Factory) -> None:
    if factory is normalising:
        return  # equal examples, as at first, have no variance: it divides rounding by next to none
    together = life(factory, [3, 4, 5])[1]
    alone = life(factory, [4])[1]
    torch.testing.assert_close(together[:, 1:2], alone, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("factory", ALL)
def test_any_module_goes_on_bit_for_bit_from_its_state(factory: Factory) -> None:
    agent, _ = life(factory, [3, 4])
    state = agent.state()
    later = life(factory, [3, 4], 20, agent)[1]
    other = IAC(SPACE, agent.config, [3, 4])
    other.load_state(state)
    assert torch.equal(life(factory, [3, 4], 20, other)[1], later)


@pytest.mark.parametrize("factory", ALL)
def test_any_module_learns_as_torchs_own_loop_lets_it(factory: Factory) -> None:
    if factory in (Noisy, dropping):
        return  # whose random numbers are each row's own
    inputs = torch.rand(2, 3 * SIZE, 3, generator=torch.Generator().manual_seed(1))
    targets = inputs.sum(2, keepdim=True)
    training = Training(optimizer="sgd", learning_rate=0.05, minibatch_size=SIZE)
    networks = StackedNetworks(factory, 3, 1, training, CPU)
    networks.reserve(2)
    networks.start(torch.arange(2), [7, 8])
    module = networks._module.made(8).train()
    optimiser = torch.optim.SGD([w for w in module.parameters() if w.requires_grad], lr=0.05)
    for batch, target in zip(
        torch.split(inputs[1], SIZE), torch.split(targets[1], SIZE), strict=True
    ):
        optimiser.zero_grad()
        nn.functional.mse_loss(module(batch), target).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    networks.train(torch.arange(2), inputs, targets, SIZE, squared_error)
    learnt = networks.network(1)
    for (name, one), other in zip(
        learnt.state_dict().items(), module.state_dict().values(), strict=True
    ):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-5, msg=name)
    outputs = networks.predict(torch.tensor([1]), inputs[1:, :5])[0]
    torch.testing.assert_close(outputs, module.eval()(inputs[1, :5]).detach(), rtol=1e-3, atol=1e-5)


def test_predicting_changes_no_buffer() -> None:
    agent, _ = life(RunningMean, [0])
    before = agent.state()
    agent.predict(torch.zeros(50, 1), torch.zeros(50, 1))
    assert_same(before, agent.state())
    assert before["experts/networks/buffers/n_seen"].tolist() != [0] * agent.tree.n_rows


def test_children_begin_with_their_parents_buffers() -> None:
    networks = StackedNetworks(RunningMean, 1, 1, Training(), CPU)
    networks.reserve(2)
    networks.start(torch.arange(1), [0])
    networks.train(torch.tensor([0]), torch.rand(1, 8, 1), torch.rand(1, 8, 1), 8, squared_error)
    networks.copy(torch.tensor([0]), torch.tensor([1]))
    one, other = (networks.network(row).state_dict() for row in (0, 1))
    assert one["n_seen"] == 8
    assert all(torch.equal(one[name], other[name]) for name in one)
    networks.train(torch.tensor([1]), torch.rand(1, 8, 1), torch.rand(1, 8, 1), 8, squared_error)
    assert networks.network(0).state_dict()["n_seen"] == 8
    assert networks.network(1).state_dict()["n_seen"] == 16


def test_weights_that_do_not_learn_stay_as_they_are_and_are_each_rows_own() -> None:
    networks = StackedNetworks(half_frozen, 2, 1, Training(), CPU)
    networks.reserve(2)
    networks.start(torch.arange(2), [0, 1])
    before = [networks.network(row).state_dict() for row in (0, 1)]
    inputs, targets = torch.rand(2, 32, 2), torch.rand(2, 32, 1)
    networks.train(torch.arange(2), inputs, targets, 32, squared_error)
    after = [networks.network(row) for row in (0, 1)]
    for one, other in zip(before, after, strict=True):
        assert torch.equal(one["0.weight"], other.state_dict()["0.weight"])
        assert not torch.equal(one["2.weight"], other.state_dict()["2.weight"])
        assert [weights.requires_grad for weights in other.parameters()] == [False] * 2 + [True] * 2
    assert not torch.equal(before[0]["0.weight"], before[1]["0.weight"])


def test_dropout_matters_and_is_each_robots_own() -> None:
    plain = life(undropped, [0, 0])[1]
    dropped = life(dropping, [0, 0])[1]
    assert torch.equal(dropped[:, 0], dropped[:, 1])  # one seed, one life
    assert not torch.equal(dropped, plain)
    state = torch.get_rng_state()
    life(dropping, [0])
    assert torch.equal(torch.get_rng_state(), state)


def test_a_population_made_in_threads_is_the_one_made_alone() -> None:
    alone = [life(normalising, [seed], 1)[0].state() for seed in range(6)]
    found: dict[int, Any] = {}

    def make(seed: int) -> None:
        torch.manual_seed(seed)  # whatever others do with the generator that all share
        found[seed] = life(normalising, [seed], 1)[0].state()

    threads = [Thread(target=make, args=(seed,)) for seed in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed, state in enumerate(alone):
        assert_same(state, found[seed])


def module_of(forward: Callable[[Any, Tensor], Tensor]) -> Factory:
    """A factory of modules with one linear layer and a forward of their own."""

    class Own(nn.Module):
        def __init__(self, n_inputs: int, n_outputs: int) -> None:
            super().__init__()
            self.linear = nn.Linear(n_inputs, n_outputs)
            self.mean: Any = 0.0

    Own.forward = forward
    return Own


def remembering(self: Any, inputs: Tensor) -> Tensor:
    outputs: Tensor = self.linear(inputs)
    self.mean = 0.9 * self.mean + 0.1 * outputs.detach().mean()
    added: Tensor = outputs + self.mean
    return added


def failing(n_inputs: int, n_outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(n_inputs, 4), nn.Sequential(nn.Tanh(), nn.Linear(5, n_outputs)))


class Growing(RunningMean):
    def forward(self, inputs: Tensor) -> Tensor:
        self.mean = torch.cat([self.mean, self.mean])
        outputs: Tensor = self.linear(inputs)
        return outputs


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        (
            failing,
            r"a module must predict outcomes \(n, 1\) from situations \(n, 2\), got RuntimeError "
            r"in layer 1\.1 \(Linear\): mat1",
        ),
        (
            module_of(lambda self, x: self.linear(x) + torch.randn(1)),
            "in Own: random numbers must be drawn in train mode only",
        ),
        (
            module_of(lambda self, x: self.linear(x) + float(np.random.rand())),  # noqa: NPY002
            "a module must give the same answer twice",
        ),
        (
            module_of(lambda self, x: self.linear(x).detach() if self.training else self.linear(x)),
            "a module must learn outcomes .* got RuntimeError in Own: element 0 of tensors",
        ),
        (
            module_of(remembering),
            r"a module must keep what it remembers in buffers \(register_buffer\), got the "
            "attribute mean of Own",
        ),
        (module_of(lambda self, x: (self.linear(x),)), r"got tuple for n = 2"),  # type: ignore[arg-type, return-value]
        (Growing, r"a module's buffers must keep their types and shapes"),
        (lambda _, o: nn.LazyLinear(o), "must have their shapes when it is made, got weight"),
        (lambda i, o: nn.Linear(i, o, dtype=torch.complex64), "weights must be real numbers"),
        (lambda i, o: nn.Linear(i, o).requires_grad_(False), "must have weights to learn, got"),
        (lambda i: nn.Linear(i, 1), "made from its numbers of inputs and outputs, got TypeE"),
        (lambda *_: "a network", "a module's factory must return a module, got 'a network'"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_regions_network_is_refused_when_it_is_made(
    factory: Factory, message: str
) -> None:
    experts = NetworkExperts(module=factory, minibatch_size=SIZE)
    for seeds in ([0], [0, 1, 2]):
        with pytest.raises(ValueError, match=message):
            IAC(SPACE, IACConfig(experts=experts, meta=None), seeds)


def test_a_minibatch_of_one_is_tried_as_such() -> None:
    experts = NetworkExperts(module=normalising, minibatch_size=1)
    with pytest.raises(
        ValueError, match=r"must learn .* in layer 1 \(BatchNorm1d\): Expected more"
    ):
        IAC(SPACE, IACConfig(experts=experts, meta=None))
