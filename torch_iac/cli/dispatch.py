"""Runs a command, and turns errors and stop signals into exit codes."""

import logging
from collections.abc import Sequence

import gymnasium as gym

from torch_iac.cli.commands import Compare, Export, Figures, Options, Resume, split_at_dashes
from torch_iac.cli.compare import compare
from torch_iac.cli.exits import StoppedBySignalError, leave, one_line
from torch_iac.cli.export import export
from torch_iac.cli.options import Train
from torch_iac.cli.replay import replay
from torch_iac.cli.train import resume, train


def draw(asked: Figures) -> None:
    """Run `torch-iac figures`."""
    from torch_iac.analysis.figures import save_figures  # with matplotlib

    for path in save_figures(asked.run_folder, pdf=asked.pdf):
        print(path)  # noqa: T201 - the command's answer


def run(asked: Train | Options, words: Sequence[str]) -> None:
    """Run a command; errors and stop signals end the program with an exit code.

    Args:
        asked: Its options.
        words: What the user typed after `torch-iac`.
    """
    logging.basicConfig(format="%(message)s")
    logging.getLogger("torch_iac").setLevel(logging.INFO)  # no log lines of other libraries
    try:
        if isinstance(asked, Train):
            train(asked, ["torch-iac", *words])
        elif isinstance(asked, Compare):
            compare(asked, split_at_dashes(words)[1])
        elif isinstance(asked, Resume):
            resume(asked)
        elif isinstance(asked, Figures):
            draw(asked)
        elif isinstance(asked, Export):
            export(asked)
        else:
            replay(asked)
    except BrokenPipeError:  # nobody reads the answer any more
        raise
    except (ValueError, OSError, FloatingPointError, gym.error.Error) as error:
        leave(2, one_line(error))
    except StoppedBySignalError as stopped:
        leave(128 + stopped.signal, str(stopped))
    except KeyboardInterrupt as interrupt:
        leave(130, str(interrupt) or "interrupted")
