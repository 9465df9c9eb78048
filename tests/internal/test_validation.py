"""Numbers, lists and texts that somebody gives."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, get_type_hints

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_iac import IACConfig
from torch_iac.drives.curriculum import Stage
from torch_iac.experiment import Experiment
from torch_iac.internal.parts import to_json
from torch_iac.internal.validation import MAX_COUNT, check_count, jsonable, plain, settle
from torch_iac.kinds import PARTS

PARTS_WITH_FIELDS = [
    *(made for part in PARTS.values() if part is not Stage and fields(made := part())),
    Stage("sound", 0.5, 1.0, 10),
    IACConfig(),
    Experiment(),
]
NUMBERS = [
    (part, of.name, hint)
    for part in PARTS_WITH_FIELDS
    for of in fields(part)
    if (hint := get_type_hints(type(part))[of.name]) in (int, float)
]
OF_LIBRARIES: list[Callable[[Any], Any]] = [
    lambda number: np.array(number)[()],
    np.array,
    lambda number: np.array([number]),
    torch.tensor,
]


def number_ids(value: Any) -> str:
    return value if isinstance(value, str) else getattr(value, "__name__", type(value).__name__)


@pytest.mark.parametrize(("part", "name", "kind"), NUMBERS, ids=number_ids)
def test_numbers_of_libraries_are_taken_for_pythons_own(part: Any, name: str, kind: type) -> None:
    for of_library in OF_LIBRARIES:
        made = replace(part, **{name: of_library(getattr(part, name))})
        value = getattr(made, name)
        assert type(value) is kind
        assert value == pytest.approx(getattr(part, name))
        json.dumps(to_json(value, PARTS))


@pytest.mark.parametrize(("part", "name", "kind"), NUMBERS, ids=number_ids)
@pytest.mark.parametrize("value", [True, "1", None, np.bool_(True), [1, 2], 1j])
def test_what_is_no_such_number_is_refused_by_name(
    part: Any, name: str, kind: type, value: Any
) -> None:
    rule = "a whole number" if kind is int else "a number"
    with pytest.raises(ValueError, match=f"^{name} must be {rule}, got "):
        replace(part, **{name: value})


@pytest.mark.parametrize(("part", "name", "kind"), NUMBERS, ids=number_ids)
@pytest.mark.parametrize("of_library", [float, np.float32, torch.tensor])
def test_nan_is_refused_wherever_a_number_is(
    part: Any, name: str, kind: type, of_library: Callable[[float], Any]
) -> None:
    del kind
    with pytest.raises(ValueError, match=rf"{name}.* must .*, got .*nan"):
        replace(part, **{name: of_library(float("nan"))})


@pytest.mark.parametrize(
    ("part", "name"), [(part, name) for part, name, kind in NUMBERS if kind is int], ids=number_ids
)
def test_a_part_of_a_whole_is_refused(part: Any, name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be a whole number, got 2.5$"):
        replace(part, **{name: 2.5})


@dataclass(frozen=True)
class Toy:
    """Every kind of field."""

    sizes: tuple[int, ...] = ()
    pair: tuple[float, float] = (0.0, 1.0)
    name: str = ""
    is_red: bool = False
    by_name: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        settle(self)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"sizes": 8}, "sizes must be a list, got 8"),
        ({"sizes": "88"}, "sizes must be a list, got '88'"),
        ({"sizes": [8, 2.5]}, "sizes.1 must be a whole number, got 2.5"),
        ({"pair": (1.0,)}, r"pair must be 2 values, got \(1.0,\)"),
        ({"name": 3}, "name must be a text, got 3"),
        ({"is_red": 1}, "is_red must be True or False, got 1"),
        ({"by_name": 3}, "by_name must be a mapping by name, got 3"),
        ({"by_name": {"a": 2.5}}, "by_name.a must be a whole number, got 2.5"),
    ],
)
def test_fields_hold_what_their_annotations_say(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        Toy(**given)


def test_lists_become_tuples_of_pythons_own_numbers() -> None:
    toy = Toy(sizes=np.array([8, 9]), pair=[1, 2], is_red=np.bool_(True))  # type: ignore[arg-type]
    assert (toy.sizes, toy.pair, toy.is_red) == ((8, 9), (1.0, 2.0), True)
    assert [type(of) for of in (*toy.sizes, *toy.pair, toy.is_red)] == [
        *(int, int, float, float, bool)
    ]


@given(st.integers(-(2**62), 2**62) | st.floats(allow_nan=False) | st.booleans())
def test_a_plain_number_is_the_number_that_it_was(number: float) -> None:
    found = plain(np.array(number))
    assert (found, type(found)) == (number, type(number))


LEAVES = st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-1, 1) | st.text(max_size=3)


@given(
    st.recursive(
        LEAVES,
        lambda of: st.lists(of, max_size=3) | st.dictionaries(st.text(max_size=3), of, max_size=3),
        max_leaves=8,
    )
)
def test_what_is_jsonable_is_what_json_gives_back(value: Any) -> None:
    assert jsonable("x", value) == json.loads(json.dumps(value))


@pytest.mark.parametrize(
    ("value", "place"),
    [({1: 2}, "x"), ({"a": [0, 1j]}, "x.a.1"), ([{"b": {3}}], "x.0.b"), (print, "x")],
)
def test_what_json_cannot_hold_is_named(value: Any, place: str) -> None:
    with pytest.raises(ValueError, match=f"^{place} must be a number, a text, .*, got "):
        jsonable("x", value)


def test_json_holds_finite_numbers_only() -> None:
    with pytest.raises(ValueError, match=r"^x.a.0 must be finite, got inf$"):
        jsonable("x", {"a": [float("inf")]})


@pytest.mark.parametrize("value", [1, MAX_COUNT, np.int64(7)])
def test_counts_in_their_range_pass(value: int) -> None:
    check_count("k", value)


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (0, "k must be at least 1, got 0"),
        (2.5, "k must be a whole number, got 2.5"),
        (True, "k must be a whole number, got True"),
        ("150", "k must be a whole number, got '150'"),
        (MAX_COUNT + 1, "k must be at most 1,000,000,000,000, got 1000000000001"),
        (10**400, "k must be at most 1,000,000,000,000, got a number of 401 digits"),
    ],
)
def test_counts_outside_are_refused_in_a_short_sentence(value: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        check_count("k", value)
