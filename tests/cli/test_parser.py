"""Options made of dataclasses."""

import re
from argparse import ArgumentTypeError
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from torch_iac.cli.parser import POSITIONAL, REPEATED, Parser, whole_number, with_values


@dataclass(frozen=True)
class Wheel:
    """A part."""

    radius: float = 0.1
    """In metres, 100 % round."""
    spokes: tuple[int, ...] = ()
    """How many."""

    def __post_init__(self) -> None:
        if self.radius <= 0:
            raise ValueError(f"radius must be above 0, got {self.radius}")


@dataclass(frozen=True)
class Robot:
    """What is told."""

    folder: Annotated[Path, POSITIONAL]
    """Where it is."""
    name: str | None = None
    """What it is called."""
    colour: Literal["red", "blue"] = "red"
    """Its colour."""
    steps: int = 0
    """How far it goes."""
    is_loud: bool = False
    """Whether it beeps."""
    size: tuple[float, float] = (1.0, 2.0)
    """Its sides."""
    word: Annotated[tuple[str, ...], REPEATED] = ()
    """What it says."""
    wheels: tuple[Wheel, ...] = (Wheel(), Wheel(0.2))
    """What it rolls on."""
    engine: Wheel = field(default_factory=Wheel)
    """What drives it."""
    unreadable: Any = None
    """No option."""


def read(text: str) -> Robot:
    defaults = Robot(Path())
    parser = Parser("robot", "FOLDER", "Move.")
    parser.add_options(defaults)
    return with_values(defaults, parser.read(text.split()))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("", {}),
        ("--name x --colour blue", {"name": "x", "colour": "blue"}),
        ("--steps 1e4", {"steps": 10_000}),
        ("--steps=-3", {"steps": -3}),
        ("--is-loud", {"is_loud": True}),
        ("--is_loud --no-is-loud", {"is_loud": False}),
        ("--size 3 4e-1", {"size": (3.0, 0.4)}),
        ("--word a --word b", {"word": ("a", "b")}),
        ("--engine.radius 3", {"engine": Wheel(3.0)}),
        ("--engine.spokes 1 2", {"engine": Wheel(spokes=(1, 2))}),
        ("--wheels.1.radius 5", {"wheels": (Wheel(), Wheel(5.0))}),
    ],
)
def test_a_field_is_an_option(words: str, expected: dict[str, Any]) -> None:
    assert read(f"a {words}") == Robot(Path("a"), **expected)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("", "the following arguments are required: FOLDER (see robot --help)"),
        ("a --nam x", "Unrecognized options: --nam, x; perhaps you meant --name"),
        ("a --colour blu", "--colour must be red or blue, got blu; perhaps you meant blue"),
        ("a --steps 1.5", "--steps must be a whole number, got 1.5 (see robot --help)"),
        ("a --size 1", "--size: expected 2 arguments"),
        ("a --engine.radius 0", "engine: radius must be above 0, got 0.0"),
        ("a --wheels.1.radius x", "--wheels.1.radius must be a number, got x"),
        ("a --wheels.1.radius -1", "wheels.1: radius must be above 0, got -1.0"),
        ("a --unreadable 3", "Unrecognized options: --unreadable, 3"),
    ],
)
def test_what_is_refused_is_one_sentence(words: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=re.escape(sentence)) as refusal:
        read(words)
    assert "\n" not in str(refusal.value)


def test_help_says_what_the_docstrings_say(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        read("--help")
    assert end.value.code == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("usage: robot FOLDER Move. options: FOLDER Where it is.")
    assert "--name TEXT What it is called. --colour {red,blue} Its colour. (default: red)" in said
    assert "--is-loud, --no-is-loud Whether it beeps. (default: off)" in said
    assert "--engine.radius FLOAT In metres, 100 % round. (default: 0.1)" in said


@given(st.integers(-(10**20), 10**20))
def test_whole_numbers_are_read_however_they_are_written(number: int) -> None:
    assert whole_number(str(number)) == number
    assert whole_number(f"{number:_}") == number
    assert whole_number(f"{number}e2") == number * 100


@pytest.mark.parametrize("text", ["", "x", "1.5", "inf", "nan", "1e-1", "1e999999999"])
def test_what_is_no_whole_number_is_refused(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="must be a whole number"):
        whole_number(text)
