"""Reading a run back, and how it went over time."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.synthetic_run import SPACE, ZONES, write_run
from torch_iac.analysis import region_history
from torch_iac.analysis.region_history import (
    ancestors,
    error_curves,
    final_leaves,
    region_bounds,
    region_zones,
)
from torch_iac.runs import reader, statistics
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.statistics import by_decile, focus_steps, known_mean, zone_errors, zone_shares

N_AGENTS, N_DECISIONS = 3, 1600


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of three agents in several parts."""
    folder = tmp_path_factory.mktemp("run")
    return load_run(write_run(folder, N_AGENTS, N_DECISIONS, rows_per_part=N_AGENTS * 300))


def test_a_run_knows_its_space_agents_and_zones(run: Run) -> None:
    assert run.space == SPACE
    assert (run.seeds, run.n_agents, run.zone_names) == ((100, 101, 102), 3, ZONES)
    assert run.n_decisions == N_DECISIONS
    assert len(run.parts()) == 6


def test_steps_are_read_over_all_parts_in_order(run: Run) -> None:
    assert run.steps["step"].to_numpy().tolist() == np.repeat(np.arange(1600), 3).tolist()
    assert run.column("agent").tolist() == [[0, 1, 2]] * 1600
    assert run.table(["step", "seed"], agent=1)["seed"].to_pylist() == [101] * 1600


def test_a_null_is_nan_in_a_column(run: Run) -> None:
    assert np.isnan(run.column("expected_error")).all()


def test_a_folder_without_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=f"{re.escape(str(tmp_path))} holds no run"):
        load_run(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("half a fi", "config.json cannot be read: JSON must be whole and strict"),
        ('{"seeds": [0]}', "config.json must be the config of a run, but it has no space"),
    ],
)
def test_a_config_of_something_else_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        _ = load_run(tmp_path).seeds


def test_what_is_not_there_yet_is_said(tmp_path: Path) -> None:
    folder = write_run(tmp_path, n_decisions=0)
    with pytest.raises(FileNotFoundError, match="holds no decisions yet"):
        _ = load_run(folder).steps
    with pytest.raises(FileNotFoundError, match="the run has not ended"):
        _ = load_run(folder).summary


@pytest.fixture
def small_run(tmp_path: Path) -> Run:
    """A run of four parts, to be broken."""
    return load_run(write_run(tmp_path, n_decisions=40, rows_per_part=10))


def test_a_missing_part_is_named(small_run: Run) -> None:
    small_run.parts()[1].unlink()
    with pytest.raises(FileNotFoundError, match=r"part-00001.parquet is missing"):
        _ = small_run.steps


def test_a_broken_part_is_named(small_run: Run) -> None:
    broken = small_run.parts()[2]
    broken.write_bytes(broken.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"part-00002.parquet cannot be read"):
        _ = small_run.steps


def test_a_part_that_is_being_written_is_not_read(small_run: Run) -> None:
    (small_run.folder / "steps" / ".part-00004.parquet.tmp").write_bytes(b"not yet")
    assert small_run.n_decisions == 40


def test_an_unknown_column_or_agent_is_named(small_run: Run) -> None:
    with pytest.raises(ValueError, match="has no column sound"):
        small_run.column("sound")
    with pytest.raises(ValueError, match=r"agent must lie in \[0, 1\), got 1"):
        small_run.table(agent=1)


def test_shares_of_zones_are_counted_window_by_window(run: Run) -> None:
    shares = zone_shares(run, window=300)
    assert shares.shape == (5, N_AGENTS, 3)  # the last 100 decisions are no window
    zones = run.column("zone")
    assert shares[2, 1, 0] == np.mean(zones[600:900, 1] == 0)
    assert_allclose(shares.sum(axis=2), 1.0)


def test_windows_that_were_kept_and_steps_say_the_same(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = zone_shares(run, 500), zone_errors(run, window=500), zone_errors(run)
    monkeypatch.setattr(reader, "WINDOW", 7)
    monkeypatch.setattr(statistics, "WINDOW", 7)  # so that none is a multiple
    counted = zone_shares(run, 500), zone_errors(run, window=500), zone_errors(run, window=250)
    for one, other in zip(kept, counted, strict=True):
        assert_allclose(one, other)
    assert [len(of) for of in kept] == [3, 3, 6]


@pytest.fixture(scope="module")
def large_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of three agents, of which one is recorded."""
    folder = tmp_path_factory.mktemp("large")
    return load_run(write_run(folder, N_AGENTS, N_DECISIONS, n_recorded=1))


def test_shares_and_errors_are_of_all_agents_recorded_or_not(run: Run, large_run: Run) -> None:
    assert_allclose(zone_shares(large_run), zone_shares(run))
    assert_allclose(zone_errors(large_run, window=750), zone_errors(run, window=750))
    assert focus_steps(large_run, "f2", 0.5) == focus_steps(run, "f2", 0.5)


def test_what_needs_the_steps_of_all_agents_says_so(large_run: Run) -> None:
    with pytest.raises(ValueError, match="multiple of 250 where the steps of 1 of 3 agents are"):
        zone_shares(large_run, window=100)
    sentence = "agent must be one of the first 1 of 3, whose steps are recorded, got 2"
    with pytest.raises(ValueError, match=sentence):
        error_curves(large_run, agent=2)
    assert large_run.column("error").shape == (N_DECISIONS, 1)
    assert large_run.family(2).num_rows > 1


def test_a_short_run_is_one_window_recorded_or_not(tmp_path: Path) -> None:
    short = load_run(write_run(tmp_path, 2, 30, n_recorded=1))
    assert zone_shares(short, window=30).shape == (1, 2, 3)
    assert zone_shares(short).shape == (0, 2, 3)


def test_a_world_without_zones_has_no_shares(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="has no zones"):
        zone_shares(load_run(write_run(tmp_path, n_decisions=3, zone_names=None)))


def test_a_run_knows_its_shadows_and_whether_there_is_mp(run: Run, tmp_path: Path) -> None:
    assert (run.shadow_names, run.error_columns) == ((), {"main": "error"})
    assert not run.has_expectations
    other = load_run(write_run(tmp_path, n_decisions=3, shadows={"a/b": 2.0}, meta=True))
    assert other.shadow_names == ("a/b",)
    assert other.error_columns == {"main": "error", "a/b": "shadow/a/b/error"}
    assert other.has_expectations
    assert_allclose(other.column("shadow/a/b/error"), 2 * other.column("error"))


def test_errors_are_averaged_by_window_agent_and_zone(run: Run) -> None:
    means = zone_errors(run, window=300)
    assert means.shape == (5, N_AGENTS, 3)
    errors, zones = run.column("error")[600:900, 1], run.column("zone")[600:900, 1]
    assert means[2, 1, 0] == pytest.approx(errors[zones == 0].mean())


def test_a_window_without_errors_in_a_zone_has_no_mean(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path / "a", n_decisions=4))
    means = zone_errors(run, window=1)[:, 0]
    assert np.isfinite(means).sum(axis=1).tolist() == [1] * 4
    without_zones = load_run(write_run(tmp_path / "b", n_decisions=4, zone_names=None))
    assert_allclose(
        zone_errors(without_zones, window=1)[:, 0, 0], without_zones.column("error")[:, 0]
    )


def test_deciles_are_of_each_agents_own_expectations() -> None:
    """Two agents expect 0 to 19 and 100 to 119, shuffled; the errors are twice that."""
    order = np.random.default_rng(0).permutation(20)
    expected = np.stack([order, 100 + order], axis=1)
    means, came = by_decile(expected, 2 * expected)
    assert_allclose(means, 50.5 + 2 * np.arange(10))
    assert_allclose(came, 2 * means)


def test_few_decisions_fill_few_deciles() -> None:
    means, _ = by_decile(np.array([[3.0], [1.0]]), np.ones((2, 1)))
    assert_allclose(means, [1.0, 3.0] + [np.nan] * 8)


def test_a_mean_of_nothing_is_nan() -> None:
    values = np.array([[1.0, np.nan], [3.0, np.nan]])
    assert_allclose(known_mean(values, axis=0), [2.0, np.nan])
    assert_allclose(known_mean(values, where=values > 1), 3.0)


def write_zones(folder: Path, zones: list[int]) -> Run:
    """Write a run of one agent that was in the given zones."""
    write_run(folder, n_decisions=len(zones))
    for path in load_run(folder).parts():
        table = pq.read_table(path)
        column = np.array(zones, dtype=np.int8)[table["step"].to_numpy()]
        place = table.column_names.index("zone")
        pq.write_table(table.set_column(place, "zone", [column]), path)
    return load_run(folder)


def test_every_situation_lies_within_the_bounds_of_its_region(run: Run) -> None:
    """And what lies within the bounds of a leaf at the end is in that leaf."""
    for agent in (0, run.n_agents - 1):
        steps = run.table(agent=agent)
        regions = steps["region"].to_numpy()
        assert region_bounds(run, 0, agent) == {}
        for region in np.unique(regions):
            bounds = region_bounds(run, int(region), agent)
            within = np.ones(len(regions), np.bool_)
            for name, (low, high) in bounds.items():
                values = steps[place_of(name)].to_numpy()
                within &= (values > low - 1e-6) & (values <= high + 1e-6)
            assert within[regions == region].all()
            if (regions[-20:] == region).any():
                assert (regions[-20:][within[-20:]] == region).all()


def place_of(name: str) -> str:
    """Return the column of a dimension of a situation."""
    kind = "action" if name in [d.name for d in SPACE.actions] else "sensor"
    return f"{kind}/{name}"


def test_focus_begins_with_the_first_window_above_the_share(tmp_path: Path) -> None:
    ten = {share: [2] * share + [0] * (10 - share) for share in range(11)}
    run = write_zones(tmp_path, ten[3] + ten[6] + ten[7] + ten[9])
    assert focus_steps(run, "f3", share=0.6, window=10) == [20]  # six in ten are not more than 0.6
    assert focus_steps(run, "f2", share=0.5, window=10) == [None]
    assert focus_steps(run, "f3", share=0.6, window=50) == [None]  # no window is full


def test_curves_are_means_over_the_line_of_descent(run: Run) -> None:
    """Each point against the definition: the last errors of the region and its ancestors."""
    steps = run.table(["error", "region"], agent=1)
    errors, regions = steps["error"].to_numpy(), steps["region"].to_numpy()
    curves = error_curves(run, agent=1, window=150)
    assert len(curves) > 5
    for curve in curves:
        line = [curve.region, *ancestors(run, curve.region, agent=1)]
        for decision, mean in zip(curve.decisions, curve.mean_errors, strict=True):
            so_far = np.isin(regions[: decision + 1], line)
            assert mean == pytest.approx(errors[: decision + 1][so_far][-150:].mean())


@pytest.mark.parametrize(
    ("numbers", "window"), [({}, 150), ({"window": 26, "inherit_history": True}, 26)]
)
def test_curves_take_the_window_that_the_run_had(
    tmp_path: Path, numbers: Mapping[str, Any], window: int
) -> None:
    run = load_run(write_run(tmp_path, n_decisions=300, numbers=numbers))
    root, errors = error_curves(run)[0], run.column("error")[:, 0]
    assert root.mean_errors[200] == pytest.approx(errors[201 - window : 201].mean())


def test_without_inheritance_a_curve_is_of_the_regions_own_errors(tmp_path: Path) -> None:
    numbers = {"window": 50, "inherit_history": False}
    run = load_run(write_run(tmp_path, n_decisions=900, numbers=numbers))
    errors, regions = run.column("error")[:, 0], run.column("region")[:, 0]
    curves = error_curves(run)
    assert len(curves) > 4
    for curve in curves:
        own = np.flatnonzero(regions == curve.region)
        assert curve.decisions[:-1].tolist() == own.tolist()
        for n_errors, mean in enumerate(curve.mean_errors[:-1], start=1):
            assert mean == pytest.approx(errors[own][max(0, n_errors - 50) : n_errors].mean())


def test_children_start_where_their_parent_ends(run: Run) -> None:
    curves = {curve.region: curve for curve in error_curves(run)}
    for region, curve in curves.items():
        line = ancestors(run, region)
        if line:
            parent = curves[line[0]]
            assert curve.decisions[0] == parent.decisions[-1]
            assert curve.mean_errors[0] == pytest.approx(parent.mean_errors[-1])


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=50),
    st.integers(1, 60),
)
def test_a_running_mean_is_the_mean_of_the_last_values(values: list[float], window: int) -> None:
    expected = [np.mean(values[max(0, i - window + 1) : i + 1]) for i in range(len(values))]
    assert_allclose(region_history._running_mean(np.array(values), window), expected, atol=1e-12)


def test_families_share_out_all_regions(run: Run) -> None:
    families = [run.family(agent) for agent in range(run.n_agents)]
    for agent, family in enumerate(families):
        assert set(family["agent"].to_pylist()) == {agent}
        assert family["region"].to_pylist() == list(range(family.num_rows))
    assert sum(family.num_rows for family in families) == run.regions.num_rows


def test_ancestors_lead_to_the_root(run: Run) -> None:
    assert ancestors(run, 0) == ()
    family = run.family(2).to_pylist()
    deepest = max(family, key=lambda row: row["depth"])
    line = ancestors(run, deepest["region"], agent=2)
    assert len(line) == deepest["depth"]
    assert line[-1] == 0


def test_a_region_has_the_zone_of_most_of_its_decisions(run: Run) -> None:
    steps = run.table(["region", "zone"], agent=0).to_pylist()
    cover = region_zones(run, agent=0)
    for region in range(len(cover.zone)):
        zones = [row["zone"] for row in steps if row["region"] == region]
        if zones:
            counts = np.bincount(zones)
            assert counts[cover.zone[region]] == counts.max()
            assert cover.purity[region] == counts.max() / len(zones)
        else:
            assert cover.zone[region] == -1
            assert np.isnan(cover.purity[region])


def test_a_decision_ends_in_the_leaf_that_came_of_its_region(run: Run) -> None:
    leaves, regions = final_leaves(run), run.column("region")
    for agent in range(run.n_agents):
        is_leaf = run.family(agent)["split_step"].to_numpy() < 0
        assert is_leaf[leaves[:, agent]].all()
        last = run.family(agent)["split_step"].to_numpy().max()
        np.testing.assert_array_equal(leaves[last + 1 :, agent], regions[last + 1 :, agent])
        for leaf, region in zip(leaves[:, agent], regions[:, agent], strict=True):
            assert region == leaf or region in ancestors(run, int(leaf), agent)


def test_windows_are_a_table_that_pandas_reads(run: Run) -> None:
    frame = run.windows.to_pandas()
    assert list(frame.columns[:5]) == ["step", "agent", "seed", "zone", "decisions"]
    assert len(frame) == 7 * N_AGENTS * len(ZONES)
    steps = run.steps.to_pandas()
    for _, row in frame.iterrows():
        inside = (steps.step >= row.step) & (steps.step < row.step + 250)
        there = steps[inside & (steps.agent == row.agent) & (steps.zone == ZONES.index(row.zone))]
        assert (row.decisions, row.seed) == (len(there), 100 + row.agent)
        assert_allclose([row.error, row.progress], [there.error.mean(), there.progress.mean()])


def test_progress_by_region_is_a_table(run: Run) -> None:
    frame = run.region_progress(every=400).to_pandas()
    steps = run.steps.to_pandas()
    assert frame.decisions.sum() == len(steps)
    assert sorted(frame.step.unique()) == [0, 400, 800, 1200]
    row = frame.iloc[len(frame) // 2]
    inside = (steps.step >= row.step) & (steps.step < row.step + 400)
    there = steps[inside & (steps.agent == row.agent) & (steps.region == row.region)]
    there = there[there.zone == ZONES.index(row.zone)]
    assert row.decisions == len(there)
    assert_allclose([row.error, row.progress], [there.error.mean(), there.progress.mean()])
    with pytest.raises(ValueError, match="every must be at least 1, got 0"):
        run.region_progress(0)
