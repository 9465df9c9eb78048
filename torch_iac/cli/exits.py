"""How commands end: stop signals, exit codes, errors in one line."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a run after the present decision."""


def one_line(error: Exception) -> str:
    """Return what an error says, in one line, without the number of the operating system."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(text.split())


class StoppedError(Exception):
    """A command was asked to stop, and did so; the sentence says how to go on.

    Attributes:
        signal: The number of the signal that asked.
    """

    def __init__(self, number: int, sentence: str) -> None:
        super().__init__(sentence)
        self.signal = number


class _Stop:
    """Whether the user, or the machine, has asked a run to stop.

    Attributes:
        signals: What was received.
    """

    def __init__(self) -> None:
        self.signals: list[int] = []

    def __call__(self) -> bool:
        return bool(self.signals)

    def receive(self, number: int, frame: object) -> None:
        """Note a signal; the second does not wait for the decision to end."""
        del frame
        if self.signals:
            raise KeyboardInterrupt
        self.signals.append(number)


@contextmanager
def stopping() -> Iterator[_Stop]:
    """Take Ctrl-C and a request to terminate as a wish to stop after the present decision."""
    stop = _Stop()
    before = {number: signal.signal(number, stop.receive) for number in STOPPING}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
