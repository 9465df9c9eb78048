"""Stop signals: Ctrl-C and a request to terminate, as a wish to stop at the next good moment."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a run after the present decision."""


class Stop:
    """Whether the user, or the machine, has asked a run to stop.

    Attributes:
        signals: What was received.
    """

    def __init__(self) -> None:
        self.signals: list[int] = []

    def __call__(self) -> bool:
        """Return whether a signal was received."""
        return bool(self.signals)

    def receive(self, number: int, frame: object) -> None:
        """Note a signal; the second does not wait for the decision to end.

        Raises:
            KeyboardInterrupt: It is the second.
        """
        del frame
        if self.signals:
            raise KeyboardInterrupt
        self.signals.append(number)


@contextmanager
def stopping() -> Iterator[Stop]:
    """Note stop signals while the block runs, instead of what they do by default."""
    stop = Stop()
    before = {number: signal.signal(number, stop.receive) for number in STOPPING}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
