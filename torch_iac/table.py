"""Growing the columns of a table: a struct of arrays whose length doubles when it is full."""

from torch import Tensor


def reserve(column: Tensor, n_rows: int, fill: float | None = None) -> Tensor:
    """Return the column itself if it has `n_rows` rows, else a copy of at least twice its length.

    Args:
        column: Shape `(capacity, ...)`.
        n_rows: How many rows are needed.
        fill: What the new rows hold. None leaves them unwritten, for columns whose rows are written
            before they are read: an operating system gives memory only to what has been written.
    """
    capacity = column.shape[0]
    if n_rows <= capacity:
        return column
    grown = column.new_empty((max(n_rows, 2 * capacity), *column.shape[1:]))
    grown[:capacity] = column
    if fill is not None:
        grown[capacity:] = fill
    return grown
