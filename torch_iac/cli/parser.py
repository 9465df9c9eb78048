"""Options of the command line from dataclasses: each field is an option, its docstring the help."""

from argparse import (
    Action,
    ArgumentError,
    ArgumentParser,
    ArgumentTypeError,
    BooleanOptionalAction,
    HelpFormatter,
)
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, fields, is_dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import cache, partial
from inspect import cleandoc
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from docstring_parser import parse_from_object

from torch_iac.internal.suggestions import suggested

Options = TypeVar("Options")
"""A dataclass whose fields are options."""

POSITIONAL, REPEATED = "positional", "repeated"
"""Annotations of fields: one that is given without its name; one option for each of its values."""

MAX_DIGITS = 4_000
"""Python itself reads no longer whole numbers."""


class Parser(ArgumentParser):
    """A parser that raises what it refuses, in one sentence that says where to find help.

    Args:
        program: The command, such as `torch-iac train`.
        usage: What follows it.
        description: What it does.
    """

    def __init__(self, program: str, usage: str, description: str) -> None:
        super().__init__(
            program,
            usage=f"{program} {usage}",
            description=description,
            allow_abbrev=False,
            exit_on_error=False,
            add_help=False,  # which argparse would put first
            formatter_class=partial(HelpFormatter, max_help_position=28),
        )
        self._names = ["--help"]
        self._options: list[tuple[Action, _Option]] = []

    def add_options(
        self,
        defaults: Any,
        title: str = "options",
        prefix: str = "",
        names: Container[str] | None = None,
    ) -> None:
        """Add an option for each field of a dataclass that words can give a value.

        Fields of a dataclass that is a field's value are options too, called `field.name`.

        Args:
            defaults: The dataclass, with the options' default values.
            title: Over the group in the help.
            prefix: Stands before the options' names.
            names: Which fields; all by default.
        """
        group = self.add_argument_group(title)
        for option in _options(defaults, prefix, names):
            action = _add(group, option)
            self._names += action.option_strings
            self._options.append((action, option))

    def read(self, words: Sequence[str]) -> dict[str, Any]:
        """Return the values of all options by name, once; `--help` ends the program.

        Raises:
            ValueError: A word is refused.
        """
        group = self.add_argument_group("help")
        group.add_argument("-h", "--help", action="help", help="Show this and exit.")
        typed = {_with_dashes(word): word for word in words}
        try:
            namespace, unknown = self.parse_known_args(list(map(_with_dashes, words)))
        except ArgumentError as error:
            said = error.message
            if error.argument_name:
                said = f"{error.argument_name}{' ' if said.startswith('must') else ': '}{said}"
            self.error(said)
        if unknown:
            near = suggested(unknown[0].partition("=")[0], self._names)
            self.error(f"Unrecognized options: {', '.join(map(typed.__getitem__, unknown))}{near}")
        values = vars(namespace).items()
        return {name: tuple(of) if isinstance(of, list) else of for name, of in values}

    def format_help(self) -> str:
        """Return the help. Docstrings are read only now: it takes some tenths of a second."""
        for action, option in self._options:
            action.help = option.help
        return super().format_help()

    def error(self, message: str) -> Any:
        """Raise instead of ending the program.

        Raises:
            ValueError: Always.
        """
        raise ValueError(f"{message} (see {self.prog} --help)")


def with_values(defaults: Options, values: Mapping[str, Any], prefix: str = "") -> Options:
    """Return a dataclass with the values that options have been given.

    Args:
        defaults: What the options were added for.
        values: What the parser read.
        prefix: As for `add_options`.

    Raises:
        ValueError: The dataclass refuses a value; the message names the part that it belongs to.
    """
    changed: dict[str, Any] = {}
    for field, hint in _fields(defaults):
        name, value = prefix + field.name, getattr(defaults, field.name)
        if is_part(value):
            changed[field.name] = with_values(value, values, f"{name}.")
        elif is_parts(value):
            changed[field.name] = tuple(
                with_values(part, values, f"{name}.{i}.") for i, part in enumerate(value)
            )
        elif name in values and _reader(hint):
            changed[field.name] = values[name]
    try:
        return replace(defaults, **changed)  # type: ignore[type-var]
    except ValueError as error:
        where = f"{prefix.rstrip('.')}: " if prefix else ""
        raise ValueError(f"{where}{error}") from None


def sentence_of(kind: type) -> str:
    """Return what the docstring of a class says before it speaks of arguments and errors."""
    text, _, _ = cleandoc(kind.__doc__ or "").partition("\n\nRaises:")
    return text


def whole_number(text: str) -> int:
    """Return the whole number that a text such as 10000, 10_000 or 1e4 is.

    Raises:
        ArgumentTypeError: It is none.
    """
    try:
        return int(text)
    except ValueError:
        pass
    try:
        number = Decimal(text)
    except InvalidOperation:
        number = Decimal("NaN")
    if not number.is_finite() or number.adjusted() > MAX_DIGITS or number != number.to_integral():
        raise ArgumentTypeError(f"must be a whole number, got {text:.80}")
    return int(number)


def number(text: str) -> float:
    """Return the number that a text is.

    Raises:
        ArgumentTypeError: It is none.
    """
    try:
        return float(text)
    except ValueError:
        raise ArgumentTypeError(f"must be a number, got {text:.80}") from None


def is_part(value: Any) -> bool:
    """Return whether a value is a dataclass, whose fields are options."""
    return is_dataclass(value) and not isinstance(value, type)


def is_parts(value: Any) -> bool:
    """Return whether a value is a tuple of dataclasses."""
    return isinstance(value, tuple) and bool(value) and all(map(is_part, value))


Reader = tuple[bool, str, Callable[[str], Any], str | int | None]
"""How words become a value: whether it is a switch; how the help shows a word; what makes it of a
word; how many words."""

READERS: dict[Any, tuple[str, Callable[[str], Any]]] = {
    int: ("INT", whole_number),
    float: ("FLOAT", number),
    str: ("TEXT", str),
    Path: ("PATH", Path),
}
"""How the help shows a type, and how it is read."""


@dataclass(frozen=True)
class _Option:
    """A field as an option.

    Attributes:
        name: How it is called, with underscores.
        reader: How it is read.
        marks: What its annotation says besides its type.
        default: Its value if it is not given.
        owner: The class that has the field.
    """

    name: str
    reader: Reader
    marks: tuple[Any, ...]
    default: Any
    owner: type

    @property
    def help(self) -> str:
        """What the field's docstring says, and the default."""
        text = _texts(self.owner).get(self.name.rpartition(".")[2], "")
        text = text.replace("\n", " ").replace("%", "%%")
        if POSITIONAL in self.marks or self.default is None or self.default == ():
            return text
        shown = str(self.default)
        if isinstance(self.default, bool):
            shown = "on" if self.default else "off"
        elif isinstance(self.default, tuple):
            shown = " ".join(map(str, self.default))
        return f"{text} (default: {shown})"


def _options(defaults: Any, prefix: str, names: Container[str] | None = None) -> Iterator[_Option]:
    """Yield the options of a dataclass."""
    for field, hint in _fields(defaults):
        name, value = prefix + field.name, getattr(defaults, field.name)
        if names is not None and field.name not in names:
            continue
        if is_part(value):
            yield from _options(value, f"{name}.")
        elif is_parts(value):
            for i, part in enumerate(value):
                yield from _options(part, f"{name}.{i}.")
        elif reader := _reader(hint):
            yield _Option(name, reader, _marks(hint), value, type(defaults))


def _fields(defaults: Any) -> list[tuple[Field[Any], Any]]:
    """Return the fields of a dataclass that can be given, each with its type."""
    try:
        hints = get_type_hints(type(defaults), include_extras=True)
    except Exception:  # a user's annotations may name what is not there at run time
        hints = {}
    return [(field, hints.get(field.name)) for field in fields(defaults) if field.init]


def _add(group: Any, option: _Option) -> Action:
    """Add an option to a group of a parser."""
    is_switch, metavar, read, n_words = option.reader
    name, default = option.name, option.default
    names, given = [f"--{name.replace('_', '-')}"], {"dest": name, "default": default}
    if POSITIONAL in option.marks:
        names, given = [name], {"type": read, "metavar": name.upper()}
    elif is_switch:
        given |= {"action": BooleanOptionalAction}
    elif REPEATED in option.marks:
        given |= {"action": "append", "default": list(default), "type": read, "metavar": metavar}
    else:
        given |= {"nargs": n_words, "type": read, "metavar": metavar}
    action: Action = group.add_argument(*names, **given)
    return action


def _marks(hint: Any) -> tuple[Any, ...]:
    """Return what an annotated type says besides."""
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


def _reader(hint: Any) -> Reader | None:
    """Return how words become a value of a type; None where they cannot."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if get_origin(hint) in (Union, UnionType):
        others = [of for of in get_args(hint) if of is not NoneType]
        hint = others[0] if len(others) == 1 else None
    if hint is bool:
        return True, "", str, None
    if get_origin(hint) is tuple:
        first, *others = get_args(hint)
        one = _reader(first)
        if one is None or any(of not in (first, ...) for of in others):
            return None
        return False, one[1], one[2], "*" if others == [...] else len(others) + 1
    if get_origin(hint) is Literal:
        choices = [str(choice) for choice in get_args(hint)]
        return False, f"{{{','.join(choices)}}}", _one_of(choices), None
    return (False, *READERS[hint], None) if hint in READERS else None


def _one_of(choices: Sequence[str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in choices:
            near = suggested(text.partition("=")[0], choices)
            raise ArgumentTypeError(f"must be {' or '.join(choices)}, got {text}{near}")
        return text

    return read


@cache
def _texts(kind: type) -> dict[str, str]:
    """Return the docstring of each field of a dataclass."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        try:
            found = parse_from_object(base).params
        except (OSError, TypeError, SyntaxError):  # its source is not at hand
            continue
        texts |= {of.arg_name: of.description for of in found if of.description}
    return texts


def _with_dashes(word: str) -> str:
    """Return an option with dashes in its name, whatever was typed."""
    if not word.startswith("--"):
        return word
    name, equals, value = word.partition("=")
    return name.replace("_", "-") + equals + value
