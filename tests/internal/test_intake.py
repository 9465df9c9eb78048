"""Numbers as others give them are taken as they are, whatever holds them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from torch_iac import IAC, IACConfig, SensorimotorSpace
from torch_iac.internal.intake import own_tensor

DTYPES = st.one_of(
    arrays.floating_dtypes(endianness="?"),
    arrays.integer_dtypes(endianness="?"),
    arrays.unsigned_integer_dtypes(endianness="?"),
    arrays.boolean_dtypes(),
    st.just(np.dtype(np.longdouble)),
)
SHAPES = arrays.array_shapes(max_dims=2, max_side=4)

LAYOUTS: dict[str, Callable[[NDArray[Any]], Any]] = {
    "as it is": lambda array: array,
    "reversed": lambda array: np.ascontiguousarray(array[::-1])[::-1],
    "every other": lambda array: np.repeat(array, 2, axis=0)[::2],
    "columns first": np.asfortranarray,
    "read-only": lambda array: np.broadcast_to(array, array.shape),
    "list": lambda array: array.tolist(),
    "rows": list,
}


@pytest.mark.parametrize("layout", LAYOUTS)
@given(data=st.data())
def test_numbers_are_taken_whatever_holds_them(layout: str, data: st.DataObject) -> None:
    dtype = data.draw(DTYPES)
    elements: dict[str, Any] = {"min_value": 0, "max_value": 100} if dtype.kind != "b" else {}
    array = data.draw(arrays.arrays(dtype, SHAPES, elements=elements))
    taken = own_tensor(LAYOUTS[layout](array), "sensors")
    assert taken.dtype == torch.float32
    assert taken.numpy().tolist() == array.astype(np.float32).tolist()


@given(arrays.arrays(np.float32, 3))
def test_float32_is_taken_to_the_bit(array: NDArray[np.float32]) -> None:
    assert own_tensor(array, "sensors").numpy().tobytes() == array.tobytes()
    assert own_tensor(torch.tensor(array), "sensors").numpy().tobytes() == array.tobytes()


@pytest.mark.parametrize("make", [np.zeros, torch.zeros])
def test_what_is_taken_is_a_copy(make: Callable[[int], Any]) -> None:
    values = make(2)
    taken = own_tensor(values, "sensors")
    values[:] = 1
    assert taken.tolist() == [0, 0]


def test_a_tensor_that_learns_is_taken_without_its_history() -> None:
    assert not own_tensor(torch.ones(2, requires_grad=True) * 2, "actions").requires_grad


def test_too_large_a_number_is_taken_as_infinite() -> None:
    """So that it is refused by its bounds, in a sentence."""
    assert own_tensor(np.array([1e300]), "sensors").tolist() == [np.inf]


@pytest.mark.parametrize(
    ("values", "got"),
    [
        (np.array([1j]), "complex128"),
        (torch.tensor([1j]), r"torch\.complex64"),
        (np.array(["a"]), "<U1"),
        ([None], "object"),
        ({"a": 1.0}, "object"),
        ([[1.0], [1.0, 2.0]], r"\[\[1\.0\], \[1\.0, 2\.0\]\]"),
    ],
)
def test_what_is_no_number_is_refused(values: Any, got: str) -> None:
    with pytest.raises(ValueError, match=rf"^sensors must be .*real numbers, got {got}"):
        own_tensor(values, "sensors")


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("dtype", [">f4", np.float64, np.float16])
def test_an_agent_takes_them(layout: str, dtype: Any, space: SensorimotorSpace) -> None:
    def lived(cast: Callable[[NDArray[Any]], Any]) -> list[Any]:
        agent = IAC(space, IACConfig(max_examples=10, window=4, delay=4), [0, 1])
        seen: list[Any] = []
        draw = np.random.default_rng(0)
        for number in range(40):
            sensors = draw.integers(0, 8, (2, 2)).astype(np.float32) / 4
            actions = draw.integers(0, 8, (2, 2)).astype(np.float32) / 8
            if number % 2:
                seen.append(agent.act(cast(sensors)).tolist())
            else:
                agent.set_actions(cast(actions), cast(sensors))
            seen.append(agent.worth(cast(actions), cast(sensors)).tolist())
            seen.append(agent.observe(cast(sensors[::-1].copy())).errors.tolist())
            seen.append(agent.predict(cast(actions), cast(sensors)).tolist())
        return seen

    assert lived(lambda array: LAYOUTS[layout](array.astype(dtype))) == lived(lambda array: array)
