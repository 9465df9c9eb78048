"""What robots make of other worlds: told and drawn from tiny runs."""

from pathlib import Path

import numpy as np
import pytest

from scripts.studies.other_worlds import DRIVES, N_PARTS, OTHERS, draw, shares, tell
from torch_iac import Experiment, IACConfig


def test_a_tiny_study_tells_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (lake,) = (subject for subject in OTHERS if subject.name == "FrozenLake")
    fields = {**lake.experiment, "seeds": (0, 1), "steps": 40}
    curious, random = (
        Experiment(**fields, config=IACConfig(drive=drive, meta=None)).run(tmp_path / name)
        for name, drive in DRIVES.items()
    )
    of_parts = shares(lake, curious, N_PARTS)
    assert of_parts.shape == (N_PARTS, 2, 3)
    assert of_parts.sum(axis=2) == pytest.approx(np.ones((N_PARTS, 2)))
    lefts = (curious.column("action/action_0") == 0).mean(axis=0)
    assert of_parts[:, :, 0].mean(axis=0) == pytest.approx(lefts)
    tell(lake, "random", random)
    assert "| down or right |" in capsys.readouterr().out
    draw([lake], [[curious, random]], tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size
