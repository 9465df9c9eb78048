"""The line that says what robots do now."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.synthetic_run import ZONES, SyntheticPopulation
from torch_iac.records import RegionSummary
from torch_iac.runs.present import present_line
from torch_iac.runs.reader import load_run
from torch_iac.runs.recorder import Recorder


def regions(agent: list[int], region: list[int], progress: list[float]) -> RegionSummary:
    agents, numbers = torch.tensor(agent), torch.tensor(region)
    return RegionSummary(
        agents, numbers, torch.tensor(progress, dtype=torch.float64), numbers, numbers
    )


def test_the_line_has_zones_error_regions_and_the_best() -> None:
    two = regions([0, 0, 0, 1], [1, 3, 4, 0], [0.1, 0.25, -0.3, 0.9])
    zones = np.array([[1, 1], [2, 1]], np.int8)
    line = present_line(np.array([[0.1, 0.2], [0.3, 0.4]]), zones, ZONES, two, "in {}".format)
    assert line == "f2 75%, f3 25%, error 0.25, 2 regions, best 3 (in 3) progress 0.25"


def test_without_zones_there_are_no_shares() -> None:
    one = regions([0], [0], [0.0])
    line = present_line(np.array([[0.5]]), None, (), one, lambda _: "")
    assert line == "error 0.5, 1 region, best 0 progress 0"


@pytest.mark.parametrize("rows_per_part", [7, 400])
def test_it_is_about_the_last_decisions_in_memory(tmp_path: Path, rows_per_part: int) -> None:
    population = SyntheticPopulation(1, 900)
    with Recorder(tmp_path, population, ZONES, rows_per_part=rows_per_part) as recorder:
        assert recorder.present() == ""
        for decision in range(1, 901):
            step, zones = population.decide()
            recorder.record(step, zones)
            if decision in (3, 430, 900):
                said = recorder.present()
    n_shown = min(250, rows_per_part)
    errors = load_run(tmp_path).column("error")[-n_shown:]
    assert f"error {errors.mean():.3g}, " in said
    assert f"{len(population.region_summary().region)} regions" in said
