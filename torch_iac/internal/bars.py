"""Progress bars."""

from threading import RLock

from tqdm import tqdm

__all__ = ["tqdm"]

# The lock that bars share by default is also one between processes: a semaphore of the operating
# system, of which Python complains as leaked if a process that shows a bar is killed.
tqdm.set_lock(RLock())
