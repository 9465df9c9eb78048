"""Error histories and learning progress, a region at a time, in the region's own time."""

import torch
from torch import Tensor

from torch_iac.table import reserve


class ErrorHistory:
    """The errors that each leaf's expert made, and what they say of its learning progress.

    Learning progress is the mean of `window` errors as it was `delay` errors ago, less that mean
    now: with errors e(1) ... e(n),

        progress =   mean(e(n - delay - window + 1) ... e(n - delay))
                   - mean(e(n - window + 1) ... e(n))

    and 0 until there are `delay + window` errors. Each row keeps the running sums of its errors in
    a ring just long enough for that, in float64.

    Args:
        n_rows: How many leaves there are at first.
        window: How many errors a mean is taken over (DELAY in 2004, theta + 1 in 2007).
        delay: How many errors apart the two means are (DELAY in 2004, tau in 2007).
        device: Where the histories are kept.

    Attributes:
        progress: Shape `(L,)`, float64, the last learning progress of each row.

    Source: Oudeyer and Kaplan (2004), section 2.1.
    """

    def __init__(self, n_rows: int, window: int, delay: int, device: torch.device) -> None:
        self.window, self.delay = window, delay
        self._size = delay + window + 1
        self._sums = torch.zeros(n_rows, self._size, dtype=torch.float64, device=device)
        self._counts = torch.zeros(n_rows, dtype=torch.int64, device=device)
        self.progress = torch.zeros(n_rows, dtype=torch.float64, device=device)
        # Where the sums stand, relative to the newest, that the two means will be made of.
        self._marks = torch.tensor([1, 0, 1 - window, 1 - delay, 1 - delay - window], device=device)

    def add(self, rows: Tensor, errors: Tensor) -> None:
        """Take in one error for each of some different rows and renew their progress.

        Args:
            rows: Shape `(A,)`.
            errors: Shape `(A,)`, float64, in scaled units.
        """
        counts = self._counts.take(rows)
        places = (counts[:, None] + self._marks) % self._size
        _, last, window_ago, delay_ago, both_ago = self._sums[rows[:, None], places].unbind(1)
        newest = last + errors
        self._sums[rows, places[:, 0]] = newest
        counts += 1
        self._counts.index_copy_(0, rows, counts)
        progress = (delay_ago - both_ago).sub_(newest).add_(window_ago).div_(self.window)
        progress.mul_(counts >= self.delay + self.window)
        self.progress.index_copy_(0, rows, progress)

    def mean_error(self, rows: Tensor) -> Tensor:
        """Return the mean of the last `window` errors of rows, or of all if they are fewer.

        Args:
            rows: Shape `(L,)`.

        Returns:
            Shape `(L,)`, float64, in scaled units; NaN without any error.
        """
        counts = self._counts[rows]
        n_errors = counts.clamp(max=self.window)
        newest = self._sums[rows, counts % self._size]
        return (newest - self._sums[rows, (counts - n_errors) % self._size]) / n_errors

    def reserve(self, n_rows: int) -> None:
        """Make room for `n_rows` rows."""
        self._sums = reserve(self._sums, n_rows, 0.0)
        self._counts = reserve(self._counts, n_rows, 0)
        self.progress = reserve(self.progress, n_rows, 0.0)

    def inherit(self, rows: Tensor, new_rows: Tensor) -> None:
        """Copy histories and progress from rows `(F,)` to new rows `(F,)`."""
        self._sums[new_rows] = self._sums[rows]
        self._counts[new_rows] = self._counts[rows]
        self.progress[new_rows] = self.progress[rows]

    def forget(self, rows: Tensor) -> None:
        """Empty the histories of rows `(F,)`: no errors, no progress."""
        self._sums[rows] = 0.0
        self._counts[rows] = 0
        self.progress[rows] = 0.0
