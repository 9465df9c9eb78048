"""Sums over decisions, agent by agent and zone by zone."""

import numpy as np
import pytest
import torch

from torch_iac.runs.schema import sum_columns
from torch_iac.runs.window_sums import RunningSums


def test_decisions_are_counted_and_summed_up_where_each_agent_was() -> None:
    running = RunningSums(2, 3, ["error"])
    running.add(torch.tensor([0, 2]), [torch.tensor([1.0, 2.0])])
    running.add(torch.tensor([0, 1]), [torch.tensor([3.0, 4.0])])
    sums = running.drain()
    assert sums.counts.tolist() == [[2, 0, 0], [0, 1, 1]]
    assert sums.sums["error"].tolist() == [[4.0, 0.0, 0.0], [0.0, 4.0, 2.0]]
    assert np.array_equal(
        sums.means("error"), [[2, np.nan, np.nan], [np.nan, 4, 2]], equal_nan=True
    )


def test_what_was_taken_does_not_change_any_more_and_is_not_taken_again() -> None:
    running = RunningSums(1, 2, ["error"])
    running.add(torch.tensor([1]), [torch.tensor([1.0])])
    first = running.drain()
    running.add(torch.tensor([0]), [torch.tensor([5.0])])
    assert first.sums["error"].tolist() == [[0.0, 1.0]]
    assert running.drain().sums["error"].tolist() == [[5.0, 0.0]]


def test_without_zones_one_stands_for_all() -> None:
    running = RunningSums(2, 0, ["error"])
    running.add(None, [torch.tensor([1.0, 2.0])])
    assert running.drain().counts.tolist() == [[1], [1]]
    assert sum_columns(["error"], []) == [["decisions"], ["error_sum"]]


def test_sums_add_up() -> None:
    running = RunningSums(1, 2, ["error"])
    parts = []
    for zone, error in ((0, 1.0), (1, 2.0), (1, 4.0)):
        running.add(torch.tensor([zone]), [torch.tensor([error])])
        parts.append(running.drain())
    both = parts[0] + parts[1] + parts[2]
    assert both.counts.tolist() == [[1, 2]]
    assert both.means("error").tolist() == [[1.0, 3.0]]
    assert both.total(0, 1).means("error").item() == pytest.approx(7 / 3)


def test_columns_are_named_zone_by_zone() -> None:
    assert sum_columns(["error"], ["f1", "f2"]) == [
        ["decisions/f1", "decisions/f2"],
        ["error_sum/f1", "error_sum/f2"],
    ]
