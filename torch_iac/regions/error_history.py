"""Error histories and learning progress of the regions."""

from typing import ClassVar

import torch
from torch import Tensor

from torch_iac.internal.state import Stateful, reserve
from torch_iac.regions.tree import Split


class ErrorHistory(Stateful):
    """The errors of each leaf's expert, and its learning progress.

    Learning progress is the mean of `window` errors as it was `delay` errors ago, less that mean
    now: with errors e(1) ... e(n),

        progress =   mean(e(n - delay - window + 1) ... e(n - delay))
                   - mean(e(n - window + 1) ... e(n))

    and 0 until there are `delay + window` errors (the papers do not say). Each row keeps the
    running sums of its errors in a ring just long enough for that, in float64.

    Args:
        n_rows: How many leaves there are at first.
        window: How many errors a mean is taken over (DELAY in 2004, theta + 1 in 2007).
        delay: How many errors apart the two means are (DELAY in 2004, tau in 2007).
        device: Where the histories are kept.

    Attributes:
        progress: Shape `(L,)`, float64, the last learning progress of each row, in scaled units.

    Example:
        Errors that fall by a half from two decisions to the next two:

        >>> history = ErrorHistory(1, window=2, delay=2, device=torch.device("cpu"))
        >>> for error in (0.8, 0.8, 0.4, 0.4):
        ...     history.add(torch.tensor([0]), torch.tensor([error], dtype=torch.float64))
        >>> history.progress
        tensor([0.4000], dtype=torch.float64)

    Source: Oudeyer and Kaplan (2004), section 2.1; its mean is over DELAY errors in the text, as
    here, and over DELAY + 1 in the formula.
    """

    tables: ClassVar = {"_n_rows": ("_sums", "_counts", "progress")}

    def __init__(self, n_rows: int, window: int, delay: int, device: torch.device) -> None:
        self.window, self.delay = window, delay
        self._size = delay + window + 1
        self._n_rows = n_rows
        self._sums = torch.zeros(n_rows, self._size, dtype=torch.float64, device=device)
        self._counts = torch.zeros(n_rows, dtype=torch.int64, device=device)
        self.progress = torch.zeros(n_rows, dtype=torch.float64, device=device)
        # Offsets from the newest sum: of the next one, and of those that its progress needs.
        self._marks = torch.tensor([1, 0, 1 - window, 1 - delay, 1 - delay - window], device=device)

    def add(self, rows: Tensor, errors: Tensor) -> None:
        """Add one error to each of some different rows and update their progress.

        Args:
            rows: Shape `(A,)`.
            errors: Shape `(A,)`, float64, in scaled units.
        """
        counts = self._counts.take(rows)
        places, sums = self._marked(rows, counts)
        newest = sums[..., 0] + errors
        counts += 1
        self._sums[rows, places[:, 0]] = newest
        self._counts.index_copy_(0, rows, counts)
        self.progress.index_copy_(0, rows, self._progress(newest, sums, counts))

    def progress_after(self, rows: Tensor, errors: Tensor) -> Tensor:
        """Return what the progress of rows would be after one more error; nothing is changed.

        Args:
            rows: Shape `(...)`.
            errors: Shape `(...)`, float64, in scaled units.

        Returns:
            Shape `(...)`, float64, in scaled units.
        """
        counts = self._counts.take(rows)
        _, sums = self._marked(rows, counts)
        return self._progress(sums[..., 0] + errors, sums, counts + 1)

    def _marked(self, rows: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
        """Return ring indices of the next sum and of those that progress needs, and these sums."""
        places = (counts[..., None] + self._marks) % self._size
        return places, self._sums[rows[..., None], places[..., 1:]]

    def _progress(self, newest: Tensor, sums: Tensor, counts: Tensor) -> Tensor:
        _, window_ago, delay_ago, both_ago = sums.unbind(-1)
        progress = (delay_ago - both_ago).sub_(newest).add_(window_ago).div_(self.window)
        return progress.mul_(counts >= self.delay + self.window)

    def mean_error(self, rows: Tensor) -> Tensor:
        """Return the mean of the last `window` errors of rows, or of all if they are fewer.

        Args:
            rows: Shape `(...)`.

        Returns:
            Shape `(...)`, float64, in scaled units; NaN without any error.
        """
        counts = self._counts[rows]
        n_errors = counts.clamp(max=self.window)
        newest = self._sums[rows, counts % self._size]
        return (newest - self._sums[rows, (counts - n_errors) % self._size]) / n_errors

    def split(self, split: Split, inherit: bool) -> None:
        """Give children their parents' histories and progress, or empty ones.

        Args:
            split: The regions that split.
            inherit: Whether the children take over what their parents had.
        """
        self._n_rows = split.n_rows
        self._sums = reserve(self._sums, split.n_rows)
        self._counts = reserve(self._counts, split.n_rows)
        self.progress = reserve(self.progress, split.n_rows)
        for column in (self._sums, self._counts, self.progress):
            if not inherit:
                column[split.rows] = 0
            column[split.new_rows] = column[split.rows]
