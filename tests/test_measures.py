"""The measures of a run."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.synthetic_run import write_run
from torch_iac import measures
from torch_iac.measures import summarise
from torch_iac.runs import Run, load_run

N_AGENTS, N_DECISIONS = 3, 1600


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of three agents."""
    return load_run(write_run(tmp_path_factory.mktemp("run"), N_AGENTS, N_DECISIONS))


def test_the_summary_on_disk_is_what_summarise_returns(run: Run) -> None:
    summary = summarise(run, run.summary["seconds"])
    assert json.loads(json.dumps(summary)) == run.summary


def test_a_summary_tells_the_story_of_the_run(run: Run) -> None:
    summary, zones, errors = run.summary, run.column("zone"), run.column("error")
    assert (summary["n_agents"], summary["n_decisions"]) == (N_AGENTS, N_DECISIONS)
    assert summary["decisions_per_second"] == N_DECISIONS / summary["seconds"]
    assert summary["zone_shares"]["f3"] == pytest.approx(np.mean(zones == 2))
    assert summary["settled_zone_shares"]["f2"] == pytest.approx(np.mean(zones[1000:] == 1))
    late = [errors[-1000:, i][zones[-1000:, i] == 0].mean() for i in range(N_AGENTS)]
    assert summary["late_zone_errors"]["f1"] == pytest.approx(np.mean(late))
    assert list(summary["first_cuts"]) == ["sound"]
    assert summary["first_cuts"]["sound"]["n_agents"] == N_AGENTS
    assert summary["first_cuts"]["sound"]["median_value"] == pytest.approx(2 / 3)
    assert summary["focus"]["f3"]["n_agents"] == N_AGENTS
    assert summary["focus"]["f3"]["median_step"] < summary["focus"]["f2"]["median_step"]


def test_a_summary_lists_agents(run: Run) -> None:
    second = run.summary["agents"][1]
    zones, family = run.column("zone")[:, 1], run.family(1).to_pylist()
    assert second["seed"] == 101
    assert second["zone_shares"]["f1"] == pytest.approx(np.mean(zones == 0))
    assert second["n_regions"] == sum(row["split_step"] < 0 for row in family)
    assert second["first_cut"] == {
        "dimension": "sound",
        "value": pytest.approx(2 / 3),
        "step": family[0]["split_step"],
    }


def test_a_summary_lists_a_bounded_number_of_agents(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measures, "N_AGENTS_LISTED", 2)
    summary = summarise(run, 1.0)
    assert [agent["seed"] for agent in summary["agents"]] == [100, 101]
    assert summary["zone_shares"] == run.summary["zone_shares"]


def test_a_short_run_has_no_settled_shares_and_no_cut(tmp_path: Path) -> None:
    summary = load_run(write_run(tmp_path, n_decisions=30)).summary
    assert summary["settled_zone_shares"] == {"f1": None, "f2": None, "f3": None}
    assert summary["first_cuts"] == {}
    assert summary["agents"][0]["first_cut"] is None
    assert summary["focus"]["f3"] == {"n_agents": 0, "median_step": None}


def test_a_world_without_zones_has_a_summary_too(tmp_path: Path) -> None:
    summary = load_run(write_run(tmp_path, n_decisions=300, zone_names=None)).summary
    assert summary["n_regions"] == 2.0
    assert summary["focus"] == {}
    assert "zone_shares" not in summary
