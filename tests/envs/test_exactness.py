"""The kinematic room gives the same bits on every processor, with any threads, in any company."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from torch_iac_envs.elementary import circle, logarithm, root
from torch_iac_envs.kinematic import ToyRoomKinematic
from torch_iac_envs.randomness import pack_seeds, uniform

ROUNDED = """add add_ sub sub_ rsub mul mul_ div neg abs abs_ sign copysign round_ clamp minimum"""
"""ATen's operations that round as IEEE 754 says, or do not round."""
IN_TURN = "cumsum"
"""Each sum is the one before, plus a number: tested below."""
WHOLE = """bitwise_and bitwise_xor __rshift__ __lshift__ remainder any bucketize nonzero equal eq gt
lt where"""
"""Of integers and truth values."""
MOVED = """_local_scalar_dense _to_copy _unsafe_view arange cat clone detach full_like index
index_put_ lift_fresh permute scalar_tensor select slice split_with_sizes stack unbind unsqueeze
view zeros zeros_like"""
"""Numbers that are only made, moved or looked at in another way."""
EXACT = set(f"{ROUNDED} {IN_TURN} {WHOLE} {MOVED}".split())


class Recorded(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Remembers the names of the operations that were carried out."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.names: set[str] = set()

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        self.names.add(func.overloadpacket.__name__)
        return func(*args, **(kwargs or {}))


def actions(moment: int, n_worlds: int) -> Tensor:
    """Return random actions, shape `(A, 3)`, that are the same on every processor."""
    numbers = uniform(pack_seeds(range(1_000, 1_000 + n_worlds), torch.device("cpu")), moment, 3)
    return (numbers * torch.tensor([2.0, 2.0, 1.0])[:, None] - torch.tensor([[1.0], [1.0], [0]])).T


def life(env: ToyRoomKinematic, n_decisions: int, world: int | None = None) -> list[Tensor]:
    """Return all that is sensed and where all is, one tensor a decision, shape `(A, numbers)`.

    With `world`, the life of that world of 100 in an `env` that holds it alone.
    """
    worlds = slice(None) if world is None else slice(world, world + 1)
    n_worlds = env.num_envs if world is None else 100
    env.reset(seed=world or 0)
    moments = []
    for moment in range(n_decisions):
        sensors, *_ = env.step(actions(moment, n_worlds)[worlds])
        state = env.get_state()
        moments.append(torch.cat([sensors, state["robot"], state["toy"]], 1))
    return moments


# The functions.


def angles(scale: float) -> NDArray[np.float64]:
    draw = np.random.default_rng(0)
    return np.concatenate([draw.uniform(-scale, scale, 10_000), np.arange(-8, 9) * math.pi / 4])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 100.0, 50_000.0])
@pytest.mark.parametrize(("dtype", "error"), [(torch.float64, 6e-16), (torch.float32, 3e-7)])
def test_cosine_and_sine_are_those_of_numpy(scale: float, dtype: torch.dtype, error: float) -> None:
    angle = torch.tensor(angles(scale), dtype=dtype)
    cos, sin = circle(angle)
    assert cos.dtype == dtype
    assert np.abs(cos.double().numpy() - np.cos(angle.double().numpy())).max() < error
    assert np.abs(sin.double().numpy() - np.sin(angle.double().numpy())).max() < error


def test_a_root_is_rounded_correctly_in_float32() -> None:
    draw = np.random.default_rng(0)
    bits = draw.integers(0, 0x7F800000, 200_000, dtype=np.int32)  # all that is finite
    numbers = np.append(bits.view(np.float32), np.array([0, 1, 2, 4, 1e-45, 3.4e38], np.float32))
    np.testing.assert_array_equal(root(torch.from_numpy(numbers)).numpy(), np.sqrt(numbers))


def test_a_root_in_float64_is_off_by_its_last_bit_at_most() -> None:
    numbers = 10 ** np.random.default_rng(0).uniform(-300, 300, 100_000)
    expected = np.sqrt(numbers)
    off = np.abs(root(torch.from_numpy(numbers)).numpy() - expected) / np.spacing(expected)
    assert off.max() <= 1


def test_logarithms_are_those_of_numpy() -> None:
    draw = np.random.default_rng(0)
    numbers = np.concatenate([10 ** draw.uniform(-300, 300, 10_000), draw.uniform(0.5, 2, 10_000)])
    expected = np.log(numbers)
    off = np.abs(logarithm(torch.from_numpy(numbers)).numpy() - expected)
    assert (off / np.maximum(np.abs(expected), 1)).max() < 3e-16
    assert logarithm(torch.ones(1)).item() == 0


def test_sums_of_slices_are_added_in_turn() -> None:
    numbers = uniform(pack_seeds(range(1_001), torch.device("cpu")), 0, 20)
    total, sums = torch.zeros(1_001, dtype=torch.float64), []
    for row in numbers:
        total = total + row.double()
        sums.append(total.float())
    assert torch.equal(numbers.cumsum(0), torch.stack(sums))


# The room.


def test_only_exact_operations_are_used() -> None:
    with Recorded() as recorded:
        life(ToyRoomKinematic(60), 4)  # some meet a wall
        life(ToyRoomKinematic(1), 10)
    assert len(recorded.names) > 20
    assert recorded.names - EXACT == set()


def test_the_guard_sees_what_is_not_exact() -> None:
    with Recorded() as recorded:
        torch.zeros(3).sin()
    assert recorded.names - EXACT == {"sin"}


@pytest.mark.parametrize("world", [0, 17, 99])
def test_a_robot_alone_is_that_of_many_to_the_bit(world: int) -> None:
    many = torch.stack(life(ToyRoomKinematic(100), 60))
    alone = torch.stack(life(ToyRoomKinematic(1), 60, world))
    assert torch.equal(many[:, world], alone[:, 0])


def test_threads_change_nothing() -> None:
    before, lives = torch.get_num_threads(), []
    try:
        for n_threads in (1, 2):
            torch.set_num_threads(n_threads)
            lives.append(torch.stack(life(ToyRoomKinematic(2_500), 2)))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*lives)
