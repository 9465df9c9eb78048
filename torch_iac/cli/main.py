"""The program `torch-iac`; help and mistyped words are answered without importing PyTorch."""

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING

from torch_iac.cli.exits import leave, one_line
from torch_iac.cli.streams import answering, prepare
from torch_iac.cli.typos import check_command, check_options

if TYPE_CHECKING:
    from torch_iac.cli.commands import Options
    from torch_iac.cli.options import Train

COMMANDS = {
    "train": "Let robots develop in a world and write down what they do.",
    "resume": "Go on with a run that was stopped or killed, from its last checkpoint, bit for bit.",
    "compare": "Let robots of several variants develop, seed by seed, and report how they differ.",
    "figures": "Draw a run into its folder: the paper's figures 2 and 3, and errors of shadows and "
    "of MP.",
    "replay": "Film a robot of a run at stages of its development, with what it predicts and "
    "learns.",
    "export": "Write a run for the Rerun viewer, or as a Minari data set.",
}
"""The commands, each with what it does; its own help begins with the same sentence."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command.

    An error that the user can fix is one sentence, with exit code 2; Ctrl-C exits with 130, a
    request to terminate with 143.

    Args:
        arguments: The words after `torch-iac`; those of the command line if none are given.
    """
    if arguments is not None:
        _main(list(arguments))
        return
    prepare()
    with answering():
        # Only a program may be ended by Ctrl-C, not a caller of this function.
        _main(sys.argv[1:], _ended_by_ctrl_c())


def _main(words: list[str], importing: AbstractContextManager[None] | None = None) -> None:
    """Run the command; `importing` is around all before it begins."""
    if words[:1] in (["--help"], ["-h"]):
        print(_help())  # noqa: T201 - the command's answer
    elif words[:1] == ["--version"]:
        from torch_iac.version import __version__

        print(f"torch-iac {__version__}")  # noqa: T201 - the command's answer
    else:
        with importing or nullcontext():
            options = _options(words)
            from torch_iac.cli.dispatch import run
        run(options, words)


def _help() -> str:
    """Return what the commands are."""
    width = max(map(len, COMMANDS))
    return "\n".join(
        [
            f"usage: torch-iac [-h] [--version] {{{','.join(COMMANDS)}}} ...",
            "",
            "Intelligent Adaptive Curiosity: robots that seek what they learn fastest.",
            "",
            *(f"  {name:{width}}  {what}" for name, what in COMMANDS.items()),
            "",
            "Each has options, which torch-iac COMMAND --help explains.",
        ]
    )


def _options(words: Sequence[str]) -> "Train | Options":
    """Parse the options of a command; a refused one ends the program."""
    try:
        check_command(words[0] if words else "none", list(COMMANDS))
        if words[0] == "train":
            check_options(words[1:])
            from torch_iac.cli.options import parse_train

            return parse_train(words[1:])
        from torch_iac.cli.commands import parse

        return parse(words)
    except BrokenPipeError:  # of the help's reader
        raise
    except (ValueError, OSError) as error:  # OSError: a file of --config
        leave(2, one_line(error))


@contextmanager
def _ended_by_ctrl_c() -> Iterator[None]:
    """Let Ctrl-C end the program at once and without a traceback: nothing has begun yet.

    An exception would not do, for modules that are being imported may swallow it.
    """

    def end(*_: object) -> None:
        os.write(2, b"torch-iac: interrupted\n")
        os._exit(130)

    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler:  # whoever began this may want Ctrl-C ignored
        yield
        return
    signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
