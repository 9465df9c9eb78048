"""The commands `torch-iac train` and `torch-iac resume`."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from torch_iac import experiment
from torch_iac.cli.answer import report_of
from torch_iac.cli.commands import Resume
from torch_iac.cli.exits import StoppedBySignalError
from torch_iac.cli.options import Train
from torch_iac.experiment import StoppedError
from torch_iac.internal.stop_signals import Stop, stopping


def train(asked: Train, words: Sequence[str]) -> None:
    """Run `torch-iac train`; `words` are its options as typed.

    Raises:
        StoppedBySignalError: A signal asked it to stop, and it has saved itself.
    """
    with _stopped_by_signals() as stop:
        run = asked.experiment().run(asked.out, stop=stop, command=words)
    print(report_of(run))  # noqa: T201 - the command's answer


def resume(asked: Resume) -> None:
    """Run `torch-iac resume`.

    Raises:
        StoppedBySignalError: A signal asked it to stop, and it has saved itself.
    """
    with _stopped_by_signals() as stop:
        run = experiment.resume(asked.run_folder, asked.steps, stop=stop)
    print(report_of(run))  # noqa: T201 - the command's answer


@contextmanager
def _stopped_by_signals() -> Iterator[Stop]:
    with stopping() as stop:
        try:
            yield stop
        except StoppedError as stopped:
            raise StoppedBySignalError(stop.signals[0], str(stopped)) from None
