"""Growing the columns of a table: a struct of arrays whose length doubles when it is full."""

from torch import Tensor


def reserve(column: Tensor, n_rows: int, fill: float) -> Tensor:
    """Return the column itself if it has `n_rows` rows, else a copy of at least twice its length.

    Args:
        column: Shape `(capacity, ...)`.
        n_rows: How many rows are needed.
        fill: What the new rows hold.
    """
    capacity = column.shape[0]
    if n_rows <= capacity:
        return column
    grown = column.new_full((max(n_rows, 2 * capacity), *column.shape[1:]), fill)
    grown[:capacity] = column
    return grown
