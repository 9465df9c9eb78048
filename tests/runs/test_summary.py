"""The measures of a run."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.synthetic_run import write_run
from torch_iac.analysis.region_history import final_leaves, leaf_purity
from torch_iac.runs import statistics
from torch_iac.runs import summary as run_summary
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.statistics import calibration
from torch_iac.runs.summary import summarise

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
    late = [errors[500:, i][zones[500:, i] == 0].mean() for i in range(N_AGENTS)]
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
    monkeypatch.setattr(run_summary, "N_AGENTS_LISTED", 2)
    summary = summarise(run, 1.0)
    assert [agent["seed"] for agent in summary["agents"]] == [100, 101]
    assert summary["zone_shares"] == run.summary["zone_shares"]


def test_a_summary_is_of_all_agents_recorded_or_not(run: Run, tmp_path: Path) -> None:
    few = load_run(write_run(tmp_path, N_AGENTS, N_DECISIONS, n_recorded=1)).summary
    assert (few["n_recorded_agents"], run.summary["n_recorded_agents"]) == (1, N_AGENTS)
    for name in ("zone_shares", "settled_zone_shares", "late_zone_errors"):
        assert few[name] == pytest.approx(run.summary[name]), name
    for name in ("n_regions", "first_cuts", "focus"):
        assert few[name] == run.summary[name], name
    assert [agent["seed"] for agent in few["agents"]] == [100, 101, 102]


def test_the_summary_compares_the_experts_with_their_shadows(tmp_path: Path) -> None:
    shadows = {"knn": 2.0, "mlp": 0.5}
    summary = load_run(write_run(tmp_path, 2, 1100, shadows=shadows, meta=True)).summary
    errors = summary["errors"]
    assert list(errors) == ["main", "knn", "mlp"]
    assert errors["main"]["zones"] == summary["late_zone_errors"]
    for name, times in shadows.items():
        assert errors[name]["mean"] == pytest.approx(times * errors["main"]["mean"])
        assert errors[name]["zones"]["f2"] == pytest.approx(times * errors["main"]["zones"]["f2"])
    by_agent = [agent["errors"]["knn"]["mean"] for agent in summary["agents"]]
    assert errors["knn"]["mean"] == pytest.approx(np.mean(by_agent))


def test_errors_are_those_of_the_last_decisions_in_whole_windows(run: Run) -> None:
    errors = run.column("error")[500:]
    assert run.summary["errors"]["main"]["mean"] == pytest.approx(errors.mean())
    assert run.summary["agents"][1]["errors"]["main"]["mean"] == pytest.approx(errors[:, 1].mean())


def test_a_right_mp_is_calibrated(tmp_path: Path) -> None:
    """The made-up MP knows the mean of every error."""
    run = load_run(write_run(tmp_path, 3, 1600, meta=True))
    found = calibration(run)
    assert found.first_step == 800
    assert found.overall.n_decisions == 3 * 800
    assert found.overall.ratio == pytest.approx(1.0, abs=0.1)
    assert sum(of.n_decisions for of in found.zones.values()) == 3 * 800
    assert found.zones["f1"].expected == pytest.approx(0.3 * np.sqrt(2 / np.pi))
    assert np.all(np.diff(found.expected) >= 0)
    assert found.actual == pytest.approx(found.expected, rel=0.3)
    told = run.summary["calibration"]
    assert told["ratio"] == found.overall.ratio
    assert (
        told["zones"]["f2"]["ratio"]
        == told["zones"]["f2"]["expected"] / (told["zones"]["f2"]["actual"])
    )
    assert told["deciles"] == {
        "expected": found.expected.tolist(),
        "actual": found.actual.tolist(),
    }


def test_calibration_begins_when_mp_has_settled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(statistics, "CALIBRATED", 20)
    run = load_run(write_run(tmp_path, 1, 100, zone_names=None, meta=True))
    found = calibration(run)
    assert (found.first_step, found.overall.n_decisions, found.zones) == (20, 80, {})
    assert found.overall.actual == pytest.approx(run.column("error")[20:].mean())


def test_a_zone_that_was_never_entered_has_no_calibration(tmp_path: Path) -> None:
    summary = load_run(write_run(tmp_path, n_decisions=1, meta=True)).summary
    zones = summary["calibration"]["zones"].values()
    assert {"expected": None, "actual": None, "ratio": None, "n": 0} in zones
    assert summary["calibration"]["deciles"]["expected"][1:] == [None] * 9


def test_without_mp_there_is_no_calibration(run: Run) -> None:
    assert run.summary["calibration"] is None
    with pytest.raises(ValueError, match="have no MP"):
        calibration(run)


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


def test_leaves_are_pure_where_cuts_part_zones(run: Run) -> None:
    """The made-up robots cut along the sound first, so hardly a leaf hears two zones."""
    purity = leaf_purity(run)
    by_hand = [
        sum(
            np.bincount(run.column("zone")[leaves == leaf, agent]).max()
            for leaf in np.unique(leaves)
        )
        / run.n_decisions
        for agent, leaves in enumerate(final_leaves(run).T)
    ]
    np.testing.assert_allclose(purity, by_hand)
    assert (purity > 0.95).all()
    shuffled = np.random.default_rng(0).permuted(run.column("zone"), axis=0)
    assert (leaf_purity(run, shuffled) < 0.8).all()
