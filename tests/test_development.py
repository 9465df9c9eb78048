"""The paper's story in short: what is easy comes first, what cannot be learnt is left alone."""

from pathlib import Path

import pytest

from torch_iac import Experiment, Run

N_STEPS = 3_000
SEEDS = range(4)

pytestmark = pytest.mark.xdist_group("development")  # the run is made once, not on every worker


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Four robots of 2004 in the kinematic room."""
    folder: Path = tmp_path_factory.mktemp("development") / "run"
    return Experiment(world="kinematic", seeds=SEEDS, steps=N_STEPS).run(folder)


def test_the_first_cut_is_on_the_sound_when_the_root_is_full(run: Run) -> None:
    for robot in run.summary["agents"]:
        assert robot["first_cut"]["dimension"] == "sound"
        assert robot["first_cut"]["step"] == 250  # the 251st: NS is 250


def test_the_easy_zone_is_the_focus_before_the_hard_one(run: Run) -> None:
    focuses = [robot["focus"] for robot in run.summary["agents"]]
    assert sum(None not in (of["f3"], of["f2"]) and of["f3"] < of["f2"] for of in focuses) >= 3


def test_what_cannot_be_learnt_is_left_alone(run: Run) -> None:
    settled = [robot["settled_zone_shares"] for robot in run.summary["agents"]]
    assert sum(shares["f1"] for shares in settled) / len(settled) < 0.1
    assert all(shares["f2"] > 2 * shares["f1"] for shares in settled)
