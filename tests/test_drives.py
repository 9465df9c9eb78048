import torch

from torch_iac.drives import Candidates, Progress, Random
from torch_iac.progress import ErrorHistory

CPU = torch.device("cpu")
CANDIDATES = Candidates(situations=torch.rand(2, 3, 4), rows=torch.tensor([[0, 1, 0], [2, 2, 2]]))


def history() -> ErrorHistory:
    """Three leaves; the errors of the second fall, of the third grow, of the first stay."""
    kept = ErrorHistory(3, window=2, delay=2, device=CPU)
    for errors in ([0.5, 1.0, 0.0], [0.5, 0.75, 0.25], [0.5, 0.5, 0.5], [0.5, 0.25, 0.75]):
        kept.add(torch.arange(3), torch.tensor(errors, dtype=torch.float64))
    return kept


def test_progress_is_that_of_the_region() -> None:
    assert Progress().worth(CANDIDATES, history()).tolist() == [[0, 0.5, 0], [-0.5, -0.5, -0.5]]


def test_to_random_nothing_is_worth_more() -> None:
    assert Random().worth(CANDIDATES, history()).tolist() == [[0] * 3] * 2
