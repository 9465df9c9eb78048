"""What the command line's parser refuses, in one sentence instead of its box of many lines."""

import contextlib
import io
import re
import sys
from collections.abc import Iterator
from typing import NoReturn

RULE = re.compile(r"^ *(?:─{5,}|-{5,}) *$", re.MULTILINE)
"""Where stdout is not UTF-8, a box is drawn in ASCII: rules of hyphens, and no sides."""
NOT_TEXT = re.compile(r"\x1b\[[\d;]*m|[│╭╮╰╯]")
"""Colours, and the sides and corners of a box."""
OPTION = re.compile(r"--(?!help)[a-z][\w.-]*")
"""The name of an option."""
PART = re.compile(r"^Error parsing (?:[A-Z]\w*: |iac\.)")
"""What the parser says before the name of an option of a part."""
HELP = re.compile(r"torch-iac(?: [a-z]+)? --help")
"""The command that explains the options."""


@contextlib.contextmanager
def plain_refusals() -> Iterator[None]:
    """Turn what a parser refuses, exit code 2 and a box on stderr, into a `ValueError`.

    Raises:
        ValueError: The parser refuses; the message is one sentence.
    """
    written = io.StringIO()
    try:
        with contextlib.redirect_stderr(written):
            yield
    except SystemExit as end:
        if end.code == 2 and written.getvalue():
            raise ValueError(sentence_in(written.getvalue())) from None
        raise
    sys.stderr.write(written.getvalue())


def sentence_in(box: str) -> str:
    """Return what a box says: its first part, what is there instead, and where to find help.

    Args:
        box: Title, parts with rules between them, the last of which says where to find help.
    """
    _, _, inside = NOT_TEXT.sub("", box).partition("\n")
    parts = (" ".join(part.split()) for part in RULE.split(inside))
    first, *others = (part for part in parts if part)
    text = PART.sub("", first).rstrip(".")
    for other in others:
        if other.startswith("Available subcommands: "):
            text += f"; {other[0].lower()}{other[1:]}"
        if other.startswith("Perhaps you meant: "):
            text += f"; perhaps you meant {', '.join(OPTION.findall(other)[:3])}"
    helps = HELP.findall(" ".join(others))
    return f"{text} (see {helps[-1]})" if helps else text


def leave(code: int, sentence: str) -> NoReturn:
    """End the program with a sentence on stderr and an exit code."""
    print(f"torch-iac: {sentence}", file=sys.stderr)  # noqa: T201 - the command's answer
    sys.exit(code)
