"""Parts of a config as JSON, and back."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch

from torch_iac.internal.parts import build, from_json, import_object, name_of, to_json


@dataclass(frozen=True)
class Wheel:
    """A part with numbers."""

    radius: float = 0.1
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Cart:
    """A part with parts."""

    wheels: tuple[Wheel, ...] = (Wheel(),)
    brake: Wheel | None = None
    horn: Callable[..., int] = field(default=len)


class Plain:
    """No dataclass, and nothing to keep."""


class Keeping:
    """No dataclass, and something that would be lost."""

    def __init__(self, secret: int = 3) -> None:
        self.secret = secret


def ring(times: int = 1) -> int:
    """A function of a module."""
    return times


KINDS: dict[str, type] = {"Wheel": Wheel}


@pytest.mark.parametrize(
    ("value", "content"),
    [
        (3, 3),
        ((1, (2.5, "a")), [1, [2.5, "a"]]),
        ({"a": None}, {"a": None}),
        (Wheel(0.5), {"kind": "Wheel", "radius": 0.5, "names": []}),
        (ring, {"object": "tests.internal.test_parts:ring"}),
        (Plain, {"object": "tests.internal.test_parts:Plain"}),
        (
            Cart(brake=Wheel(), horn=ring),
            {
                "kind": "tests.internal.test_parts:Cart",
                "wheels": [{"kind": "Wheel", "radius": 0.1, "names": []}],
                "brake": {"kind": "Wheel", "radius": 0.1, "names": []},
                "horn": {"object": "tests.internal.test_parts:ring"},
            },
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_json_holds_a_part_in_full(value: Any, content: Any) -> None:
    assert to_json(value, KINDS) == content
    assert from_json(json.loads(json.dumps(content)), KINDS) == value


def test_an_object_without_attributes_is_made_anew() -> None:
    content = to_json(Plain(), KINDS)
    assert content == {"kind": "tests.internal.test_parts:Plain"}
    assert isinstance(from_json(content, KINDS), Plain)


HERE = "tests.internal.test_parts"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ({"kind": "Weel"}, r"value must be of a known kind \(Wheel\), got 'Weel'"),
        ({"kind": ["Wheel"]}, r"value must be of a known kind \(Wheel\), got \['Wheel'\]"),
        ({"kind": "Wheel", "size": 1}, "value must have fields among names, radius, got size"),
        ({"kind": "Wheel", "radius": "big"}, "value.radius must be of its type, got 'big'"),
        ({"kind": "Wheel", "names": [1]}, r"value.names must be of its type, got \(1,\)"),
        ({"kind": f"{HERE}:ring"}, "value must be of a class, got .*ring, which is none"),
        ({"object": "no_such_module:X"}, "value must be importable, got no_such_module:X"),
        ({"object": f"{HERE}:gong"}, "value must be in its module, got .*:gong, which is not"),
        ({"object": "ring"}, "value must be written module:Name, got 'ring'"),
        ({"object": 3}, "value must be written module:Name, got 3"),
        ([{"kind": "Weel"}], "value.0 must be of a known kind"),
    ],
)
def test_what_cannot_be_made_is_refused_in_one_sentence(content: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        from_json(content, KINDS)


def test_what_would_be_lost_is_refused() -> None:
    with pytest.raises(ValueError, match=r"must be a dataclass .*\(secret\), got .*Keeping"):
        from_json(to_json(Keeping(), KINDS), KINDS)


@dataclass(frozen=True)
class Users:
    """A user's own dataclass, which checks nothing."""

    value: Any


@pytest.mark.parametrize(
    "number", [np.int64(9), np.float32(0.5), np.bool_(True), torch.tensor(9), np.array([9])]
)
def test_numbers_of_libraries_are_held_as_numbers(number: Any) -> None:
    content = to_json(Users(number), KINDS)
    assert json.loads(json.dumps(content))["value"] == number.item()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (np.array([1, 2]), np.array([1, 3])),
        (torch.tensor([1.0, 2.0]), torch.tensor([1.0, 3.0])),
        (partial(max, 1), partial(max, 2)),
        ({1, 2}, {1, 3}),
        (b"a", b"b"),
        (1j, 2j),
        (Keeping(), Keeping(4)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_json_cannot_hold_is_told_apart_and_never_made_again(one: Any, other: Any) -> None:
    told = to_json(Users(one), KINDS)
    assert json.dumps(told) == json.dumps(to_json(Users(one), KINDS))
    assert told != to_json(Users(other), KINDS)
    with pytest.raises(ValueError, match=r"value\.value must be a dataclass for its attributes"):
        from_json(json.loads(json.dumps(told)), KINDS)


@pytest.mark.parametrize("value", [lambda: 1, lambda: 2])
def test_a_local_function_is_refused_with_what_to_do(value: Callable[[], int]) -> None:
    with pytest.raises(ValueError, match="define it outside of any function"):
        import_object(name_of(value))


def test_a_field_that_is_missing_is_named() -> None:
    @dataclass(frozen=True)
    class Needy:
        size: int

    with pytest.raises(ValueError, match=r"part must be made of its fields: .*size"):
        build(Needy, {}, "part")
