"""Nested state goes through flat tensors and JSON and comes back as it was."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from safetensors.torch import load, save

from torch_iac.internal.files import dump_json, parse_json
from torch_iac.internal.serialize import pack, unpack

PLAIN = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**128), 2**128),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(),
)
NUMBERS = st.one_of(
    arrays.boolean_dtypes(),
    arrays.integer_dtypes(endianness="="),
    arrays.unsigned_integer_dtypes(endianness="="),
    arrays.floating_dtypes(endianness="=", sizes=(16, 32, 64)),
)
ARRAYS = arrays.arrays(NUMBERS, arrays.array_shapes(min_dims=0, min_side=0, max_side=3))
NAMES = st.text(st.characters(codec="utf-8", exclude_characters="/"))
NESTS = st.recursive(
    st.one_of(PLAIN, ARRAYS),
    lambda nests: st.one_of(
        st.lists(nests, max_size=4),
        st.lists(nests, max_size=4).map(tuple),
        st.dictionaries(NAMES, nests, max_size=4),
    ),
    max_leaves=12,
)


def through_a_file(value: Any) -> Any:
    tensors, content = pack(value)
    return unpack(load(save(tensors)), parse_json(dump_json(content)))


def assert_same(one: Any, other: Any) -> None:
    """Values, types, order and bits are the same."""
    assert type(one) is type(other)
    if isinstance(one, (np.ndarray, np.generic)):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        assert one.tobytes() == other.tobytes()
    elif isinstance(one, dict):
        assert list(one) == list(other)
        assert_same(list(one.values()), list(other.values()))
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other)
        for part, other_part in zip(one, other, strict=True):
            assert_same(part, other_part)
    else:
        assert repr(one) == repr(other)  # tells -0.0 from 0.0


@given(NESTS)
def test_everything_comes_back(value: Any) -> None:
    assert_same(value, through_a_file(value))


def test_a_random_generators_state_comes_back() -> None:
    state = np.random.default_rng(3).bit_generator.state
    assert_same(state, through_a_file(state))


def test_tensors_come_back_on_the_cpu_and_are_copies() -> None:
    tensor = torch.arange(6.0).view(2, 3).T
    tensors, content = pack({"a": tensor, "b": tensor, "half": torch.ones(2).bfloat16()})
    tensor[0, 0] = 7
    back = unpack(tensors, content)
    assert back["a"].tolist() == [[0, 3], [1, 4], [2, 5]]
    assert torch.equal(back["a"], back["b"])
    assert back["half"].dtype == torch.bfloat16


def test_arrays_of_any_layout_come_back() -> None:
    array = np.arange(6, dtype=">f4").reshape(2, 3).T
    assert through_a_file(array).tolist() == array.tolist()
    assert_same(np.float64(2.5), through_a_file(np.float64(2.5)))


@pytest.mark.parametrize(
    ("value", "kind", "message"),
    [
        (
            {"a": [object()]},
            TypeError,
            "a/0 must be made of numbers to be saved, got a object",
        ),
        (
            {"a": np.array([None])},
            TypeError,
            "a must hold plain numbers to be saved, got object",
        ),
        ({"a": np.array(["x"])}, TypeError, "a must hold plain numbers to be saved, got <U1"),
        (
            {"a": np.ones(1, complex)},
            TypeError,
            "a must hold plain numbers to be saved, got c",
        ),
        ({1: 2}, TypeError, "state must have names for keys, got 1"),
        ({"a": float("nan")}, ValueError, "a must be finite, got nan"),
        ({"a/b": np.ones(1), "a": {"b": np.ones(1)}}, ValueError, "a/b must name one tensor"),
        ({1, 2}, TypeError, "state must be made of numbers to be saved, got a set"),
    ],
)
def test_what_cannot_be_packed_is_named(value: Any, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        pack(value)


def test_what_could_not_be_read_back_is_not_written() -> None:
    deep: Any = 1
    for _ in range(60):
        deep = [deep]
    with pytest.raises(ValueError, match="JSON must be nested at most 100 deep, got more"):
        through_a_file(deep)
