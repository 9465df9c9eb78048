import torch

from torch_iac.internal.state import reserve


def test_a_full_column_doubles_and_keeps_what_it_holds() -> None:
    column = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    assert reserve(column, 2, 9.0) is column
    grown = reserve(column, 3, 9.0)
    assert grown.tolist() == [[1, 2], [3, 4], [9, 9], [9, 9]]
    assert len(reserve(column, 7, 0.0)) == 7
