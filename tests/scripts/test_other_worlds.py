"""The study of other worlds, in a tiny one."""

from pathlib import Path

import numpy as np
import pytest

from scripts.studies.other_worlds import N_PARTS, OTHERS, Study, draw, runs_of, shares, tell


def test_a_tiny_study_tells_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (lake,) = (subject for subject in OTHERS if subject.name == "FrozenLake")
    study = Study(out=tmp_path, processes=1)
    ((curious, random),) = runs_of(study, "others", {"lake": lake.experiment}, 2, 40)
    of_parts = shares(lake, curious, N_PARTS)
    assert of_parts.shape == (N_PARTS, 2, 3)
    assert of_parts.sum(axis=2) == pytest.approx(np.ones((N_PARTS, 2)))
    lefts = (curious.column("action/action_0") == 0).mean(axis=0)
    assert of_parts[:, :, 0].mean(axis=0) == pytest.approx(lefts)
    tell(lake, "random", random)
    assert "| down or right |" in capsys.readouterr().out
    draw([lake], [[curious, random]], tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size
