import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests import oracle
from torch_iac.regions.error_history import ErrorHistory
from torch_iac.regions.tree import Split

CPU = torch.device("cpu")
ROW = torch.tensor([0])


def follow(errors: list[float], window: int, delay: int) -> tuple[ErrorHistory, list[float]]:
    """A history that took in the errors, and its progress after each."""
    history = ErrorHistory(1, window, delay, CPU)
    progress = []
    for error in errors:
        history.add(ROW, torch.tensor([error], dtype=torch.float64))
        progress.append(history.progress.item())
    return history, progress


def test_constant_errors_make_no_progress() -> None:
    assert set(follow([0.25] * 700, 150, 150)[1]) == {0.0}


def test_a_linear_fall_of_errors_is_progress_of_the_fall_over_the_delay() -> None:
    errors = [1 - i / 1024 for i in range(700)]
    progress = follow(errors, 150, 150)[1]
    assert set(progress[:299]) == {0.0}
    assert progress[299:] == pytest.approx([150 / 1024] * 401)
    assert follow(errors, 26, 15)[1][-1] == pytest.approx(15 / 1024)


def test_noisy_errors_make_progress_of_the_size_of_their_means_noise() -> None:
    errors = torch.rand(20_000, generator=torch.Generator().manual_seed(0)).tolist()
    progress = torch.tensor(follow(errors, 150, 150)[1][299:])
    expected_sd = math.sqrt(2 / 150 / 12)  # of the difference of two means of 150 uniform numbers
    assert abs(progress.mean()) < 0.2 * expected_sd
    assert progress.std().item() == pytest.approx(expected_sd, rel=0.2)


@given(st.lists(st.floats(0, 1), max_size=40), st.integers(1, 9), st.integers(1, 9))
def test_progress_is_its_definition(errors: list[float], window: int, delay: int) -> None:
    robot = oracle.Robot(window=window, delay=delay)
    expected = []
    for error in errors:
        robot.root.errors.append(error)
        expected.append(robot.progress(robot.root))
    history, progress = follow(errors, window, delay)
    assert progress == pytest.approx(expected, abs=1e-12)
    last = errors[-window:]
    mean = sum(last) / len(last) if last else math.nan
    assert history.mean_error(ROW).item() == pytest.approx(mean, abs=1e-12, nan_ok=True)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=40), st.integers(1, 9), st.integers(1, 9))
def test_imagined_errors_make_the_progress_of_real_ones_and_leave_no_trace(
    errors: list[float], window: int, delay: int
) -> None:
    history, _ = follow(errors[:-1], window, delay)
    last = torch.tensor([[errors[-1], 0.5]], dtype=torch.float64)
    imagined = history.progress_after(torch.zeros(1, 2, dtype=torch.int64), last)
    history.add(ROW, last[:, 0])
    assert history.progress.item() == imagined[0, 0].item()


@pytest.mark.parametrize("inherit", [True, False])
def test_children_inherit_or_start_anew(inherit: bool) -> None:
    history, progress = follow([1 - i / 64 for i in range(20)], 4, 4)
    split = Split(ROW, torch.tensor([1]), ROW, torch.tensor([1]), n_rows=2)
    history.split(split, inherit)
    both = torch.tensor([0, 1])
    if not inherit:
        assert history.progress.tolist() == [0.0, 0.0]
        assert history.mean_error(both).isnan().all()
        return
    assert history.progress.tolist() == [progress[-1]] * 2
    history.add(both, torch.tensor([0.0, 1.0], dtype=torch.float64))
    assert history.progress[0] > progress[-1] > history.progress[1]
