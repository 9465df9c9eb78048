"""Progress bars."""

import sys
from threading import RLock
from typing import Any

import tqdm as bars

__all__ = ["tqdm"]


class tqdm(bars.tqdm):  # type: ignore[misc]  # noqa: N801 - as it is known
    """A bar that is not drawn where there is no stream to draw on."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        if sys.stderr is None:
            options["disable"] = True
        super().__init__(*arguments, **options)


# The lock that bars share by default is also one between processes: a semaphore of the operating
# system, of which Python complains as leaked if a process that shows a bar is killed.
tqdm.set_lock(RLock())
