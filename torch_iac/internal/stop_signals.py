"""Stop signals: SIGINT (Ctrl-C) and SIGTERM set a flag instead of ending the process."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a run after the present decision."""


class Stop:
    """Whether a run was asked to stop.

    Attributes:
        signals: The signals received.
    """

    def __init__(self) -> None:
        self.signals: list[int] = []

    def __call__(self) -> bool:
        """Return whether a signal was received."""
        return bool(self.signals)

    def receive(self, number: int, frame: object) -> None:
        """Record a signal; the second one raises at once.

        Raises:
            KeyboardInterrupt: It is the second.
        """
        del frame
        if self.signals:
            raise KeyboardInterrupt
        self.signals.append(number)


@contextmanager
def stopping() -> Iterator[Stop]:
    """Record stop signals while the block runs, in place of their default handlers."""
    stop = Stop()
    before = {number: signal.signal(number, stop.receive) for number in STOPPING}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
