"""Mistyped names of commands and options, found without importing what has them.

The parser of `torch-iac train` needs the engine, and with it PyTorch, which takes seconds to
import. The names of its options are the fields that the engine's source declares, and source can be
read without being run. A name that no source declares is surely mistyped; about any other, and
about all values, the parser decides.
"""

import ast
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from torch_iac.internal.suggestions import suggested, suggested_one

DECLARING = (
    "cli/options",
    "config",
    "drives/baselines",
    "drives/choices",
    "drives/curriculum",
    "drives/learning_progress",
    "drives/protocol",
    "experts/hybrid",
    "experts/knn",
    "experts/mlp",
    "experts/network",
    "experts/stacked_networks",
    "meta_predictor",
)
"""The modules whose classes have the options of `torch-iac train` as fields."""

NO_OPTIONS = ("Candidates", "Knowledge")
"""Classes there whose fields are not options."""

NAME = re.compile(r"--([a-z][\w.-]*)", re.IGNORECASE)
"""An option, without what may follow an equals sign."""

VALUE = re.compile(r"-?\d.*|-|[^-].*|", re.DOTALL)
"""A word that is no option, such as a negative number."""

OWN = re.compile(r"(--(experts|drive|choice|shadows)=)?\w[\w.]*:\w")
"""A part of a user's own, such as `my_module:MyNet`."""


def check_command(word: str, commands: Sequence[str]) -> None:
    """Refuse a word that is no command.

    Raises:
        ValueError: It is none; the message says which there are, and which was perhaps meant.
    """
    if word not in commands:
        raise ValueError(
            f"the command must be one of {', '.join(commands)}, got {word}"
            f"{suggested_one(word, commands)} "
            "(see torch-iac --help)"
        )


def check_options(words: Sequence[str]) -> None:
    """Refuse options that `torch-iac train` does not have.

    Raises:
        ValueError: There are such; the message says which were perhaps meant.
    """
    if any(OWN.match(word) or word.startswith("--config") for word in words):
        return  # parts of a user's own have options of their own, also those in a file
    known = declared_names()
    unknown = list(_unknown(words, known)) if known else []
    if unknown:
        typed = NAME.match(unknown[0])
        perhaps = suggested(_plain(typed[1]), known, prefix="--") if typed else ""
        raise ValueError(
            f"Unrecognized options: {', '.join(unknown)}{perhaps} (see torch-iac train --help)"
        )


def declared_names() -> set[str]:
    """Return the fields of all classes of `DECLARING`, as options are written.

    There are none where only compiled files are installed.
    """
    folder = Path(__file__).parents[1]
    sources = [folder / f"{module}.py" for module in DECLARING]
    trees = [ast.parse(path.read_bytes()) for path in sources if path.exists()]
    return {name.replace("_", "-") for tree in trees for name in _fields(tree)}


def _fields(module: ast.Module) -> Iterator[str]:
    classes = [node for node in module.body if isinstance(node, ast.ClassDef)]
    declaring = (owner for owner in classes if owner.name not in NO_OPTIONS)
    for line in (line for owner in declaring for line in owner.body):
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            yield line.target.id


def _unknown(words: Sequence[str], known: set[str]) -> Iterator[str]:
    """Yield unknown options, each with the values that follow it."""
    is_unknown = False
    for word in words:
        if word == "--":
            return
        option = NAME.match(word)
        if option:
            is_unknown = not _is_known(_plain(option[1]), known)
        elif not VALUE.fullmatch(word):
            is_unknown = False
        if is_unknown:
            yield word


def _plain(option: str) -> str:
    """Return how an option is declared: without the part that it belongs to, and without a no."""
    last = option.replace("_", "-").rpartition(".")[2]
    return last.removeprefix("no-")


def _is_known(name: str, known: set[str]) -> bool:
    return name in known or name.isdigit() or name == "help"
