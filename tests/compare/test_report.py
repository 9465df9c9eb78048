"""Reports: numbers against those in the runs' summaries, files, pictures, TensorBoard's page."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.metadata import (
    EXPERIMENT_TAG,
    SESSION_START_INFO_TAG,
    parse_experiment_plugin_data,
    parse_session_start_info_plugin_data,
)

from tests.synthetic_run import write_run
from torch_iac import Error, Experiment, HybridExperts, IACConfig
from torch_iac.analysis.intervals import Estimate, holm
from torch_iac.compare.executors import run_experiment
from torch_iac.compare.plan import Comparison, Variant
from torch_iac.compare.plots import Curves, draw_errors, draw_improvements, draw_shares
from torch_iac.compare.report import FEW, save_report
from torch_iac.compare.results import (
    Measure,
    Row,
    differences_of,
    measure_rows,
    measures_of,
    shown_pairs,
)
from torch_iac.runs.reader import Run, load_run

VARIANTS = (
    Variant("wide", Experiment()),
    Variant("narrow", Experiment(config=IACConfig(window=75)), ("--window", "75")),
)


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """Two variants, made up, each with a block of three and one of two robots; one run failed."""
    folder = tmp_path_factory.mktemp("comparisons") / "a"
    comparison = Comparison(folder, VARIANTS, ("--steps", "1500"), n_seeds=5, block=3)
    for job in comparison.jobs():
        if job.name == "narrow/seeds-003-004":
            job.fail("no luck")
        else:
            numbers = {"window": 75, "drive": Error()} if job.variant == "narrow" else {}
            write_run(job.folder, len(job.seeds), numbers=numbers, shadows={"mlp": 2.0})
    save_report(comparison)
    return comparison


@pytest.fixture(scope="module")
def runs(comparison: Comparison) -> dict[str, list[Run]]:
    """Its runs that have ended."""
    done = [job for job in comparison.jobs() if job.state == "done"]
    return {
        variant.name: [load_run(job.folder) for job in done if job.variant == variant.name]
        for variant in VARIANTS
    }


def test_the_table_has_a_row_a_robot(comparison: Comparison, runs: dict[str, list[Run]]) -> None:
    table = pq.read_table(comparison.folder / "measures.parquet").to_pylist()
    assert [row["variant"] for row in table] == ["wide"] * 5 + ["narrow"] * 3
    agent = runs["wide"][0].summary["agents"][1]
    assert table[1]["run"] == "wide/seeds-000-002"
    assert table[1]["seed"] == agent["seed"]
    assert table[1]["error"] == agent["errors"]["main"]["mean"]
    assert table[1]["shadow/mlp/error"] == agent["errors"]["mlp"]["mean"]
    assert table[1]["share/f2"] == agent["settled_zone_shares"]["f2"]
    assert table[1]["error/f1"] == agent["late_zone_errors"]["f1"]
    assert table[1]["focus/f3"] == agent["focus"]["f3"]
    assert table[1]["n_regions"] == agent["n_regions"]


def test_differences_pair_the_seeds_that_both_have(
    comparison: Comparison, runs: dict[str, list[Run]]
) -> None:
    measures = measures_of([run for of in runs.values() for run in of])
    rows = measure_rows(comparison, runs, measures)
    by_name = {m.name: m for m in measures}
    for row in rows:
        row["seed"] = rows.index(row) % 5  # those of made-up runs repeat
        row["error"] = row["seed"] + (0.5 if row["variant"] == "wide" else 0.0)
        row["focus/f2"] = math.nan if row["seed"] == 1 else row["seed"]
        row["n_regions"] = math.nan  # of nobody is it known
    names = ("error", "focus/f2", "n_regions")
    found = differences_of(rows, [by_name[name] for name in names], ["wide", "narrow"])
    by = found[0].by
    assert [by.value, by.low, by.high, by.n] == pytest.approx([0.5, 0.5, 0.5, 3])
    # Of 0.5, 1.5, 2.5 against 0, 1, 2 a third of the pairs are lower, which is better.
    assert found[0].improvement is not None
    assert found[0].improvement.value == pytest.approx(1 / 3)
    assert [of.by.n for of in found] == [3, 2]


def made_up(n_seeds: int, gaps: Mapping[str, float], variants: Sequence[str]) -> list[Row]:
    """Return rows of robots whose measures differ by a gap a variant, and else by chance."""
    rng = np.random.default_rng(0)
    return [
        {"variant": name, "seed": seed}
        | {measure: place * gap + rng.normal() for measure, gap in gaps.items()}
        for place, name in enumerate(variants)
        for seed in range(n_seeds)
    ]


def measures_named(names: Iterable[str]) -> list[Measure]:
    return [Measure(name, name, name, "lower", (name,)) for name in names]


def test_bold_is_corrected_for_all_that_the_report_shows() -> None:
    variants = ["a", "b", "c", "d", "e"]
    gaps = {"large": 9.0, **{f"none {n}": 0.0 for n in range(30)}}
    measures = measures_named(gaps)
    found = differences_of(made_up(10, gaps, variants), measures, variants)
    assert len(found) == 31 * 10
    shown = [of for of in found if of.one == "a"]  # of five variants
    assert {(of.one, of.other) for of in shown} == set(shown_pairs(variants))
    assert holm(np.array([of.p for of in shown])).tolist() == [of.p_holm for of in shown]
    assert all(math.isnan(of.p_holm) for of in found if of.one != "a")
    assert [of.measure.name for of in found if of.is_clear] == ["large"] * 4
    assert sum(of.p < 0.05 for of in shown) > 4  # would have been in bold


@pytest.mark.parametrize(("n_seeds", "is_clear"), [(9, False), (10, True)])
def test_with_few_seeds_nothing_is_clear(n_seeds: int, is_clear: bool) -> None:
    rows = made_up(n_seeds, {"large": 99.0}, ["a", "b"])
    (found,) = differences_of(rows, measures_named(["large"]), ["a", "b"])
    assert found.p < 1e-6
    assert found.is_clear == is_clear


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of a comparison made by a script, with eleven robots a variant."""
    folder = tmp_path_factory.mktemp("comparisons") / "many"
    error = IACConfig(drive=Error(), meta=None)
    variants = (Variant("progress", Experiment()), Variant("error", Experiment(config=error)))
    comparison = Comparison(folder, variants, n_seeds=11, block=11)
    for job in comparison.jobs():
        write_run(job.folder, 11, 300)
    return save_report(comparison).read_text()


def test_a_report_names_the_settings_of_variants_without_options(many: str) -> None:
    assert "| progress | `drive.kind=Progress`, `meta.kind=MetaPredictor`, " in many
    own = "`drive.kind=Error`, `meta.kind=none`, `drive.source=region`"
    assert f"| error | {own} | 1 done |" in many
    assert "Robots with seeds 0 to 10, at most 11 a run.\n" in many


def test_few_seeds_are_said_to_be_few(comparison: Comparison, many: str) -> None:
    few = (comparison.folder / "report.md").read_text()
    assert few.count(FEW) == 2
    assert "**" not in few
    assert FEW not in many
    table = many.partition("## Differences")[2].partition("## Over time")[0]
    n_shown = table.count(" | progress - error | ")
    assert f"Holm's correction for all {n_shown} differences" in table
    assert "| number of regions | progress - error | 0 in all |  | 11 |" in many


def test_no_interval_looks_like_a_point(comparison: Comparison, many: str) -> None:
    for text in (many, (comparison.folder / "report.md").read_text()):
        found = re.findall(r"(\S+) \((\S+) to (\S+?)\)", text.partition("## Measures")[2])
        assert len(found) > 10
        assert all(low != high for _, low, high in found)


def test_the_file_has_what_bold_is_made_of(comparison: Comparison) -> None:
    table = pq.read_table(comparison.folder / "differences.parquet").to_pylist()
    known = [row for row in table if row["p"] is not None]
    assert {row["n_seeds"] for row in known} == {3}
    assert all(row["p"] <= row["p_holm"] <= 1 for row in known)


def test_shares_of_the_network_are_measured_of_hybrid_experts(tmp_path: Path) -> None:
    world = Experiment(world="Pendulum-v1", bounds_from=50, steps=60)
    hybrid = replace(world, config=IACConfig(experts=HybridExperts(), meta=None))
    variants = (Variant("knn", world), Variant("hybrid", hybrid))
    comparison = Comparison(tmp_path, variants, n_seeds=2, block=2)
    for job in comparison.jobs():
        run_experiment(job)
    text = save_report(comparison).read_text()
    (line,) = [line for line in text.splitlines() if line.startswith("| share of the network")]
    assert "| none |" in line
    (run,) = [load_run(job.folder) for job in comparison.jobs() if job.variant == "hybrid"]
    shares = [agent["network_share"]["mean"] for agent in run.summary["agents"]]
    assert np.mean(shares) == pytest.approx(run.summary["network_share"]["mean"])
    rows = pq.read_table(tmp_path / "measures.parquet").to_pylist()
    assert [row["network_share"] for row in rows] == [None, None, *shares]


def test_the_report_says_what_was_compared_and_what_is_missing(comparison: Comparison) -> None:
    text = (comparison.folder / "report.md").read_text()
    assert "| narrow | `--window 75` | 1 done, 1 failed |" in text
    assert "options for all: `--steps 1500`" in text
    assert "- narrow/seeds-003-004 failed: no luck (`narrow/seeds-003-004.log`)" in text
    for name in ("shares", "errors", "improvement"):
        assert f"(figures/{name}.png)" in text
        assert (comparison.folder / "figures" / f"{name}.png").stat().st_size > 1000


def test_curves_are_there_for_notebooks(comparison: Comparison, runs: dict[str, list[Run]]) -> None:
    table = pq.read_table(comparison.folder / "curves.parquet").to_pylist()
    assert len(table) == (5 + 3) * 6 * 4
    shares = {
        zone: [row["share"] for row in table if row["zone"] == zone and row["variant"] == "narrow"]
        for zone in ("f1", "f2", "f3")
    }
    expected = np.mean(
        [agent["zone_shares"]["f2"] for agent in runs["narrow"][0].summary["agents"]]
    )
    assert np.mean(shares["f2"]) == pytest.approx(expected)
    assert np.allclose(np.sum(list(shares.values()), axis=0), 1)
    assert {row["share"] for row in table if row["zone"] is None} == {1.0}


def test_tensorboard_finds_settings_and_measures(comparison: Comparison) -> None:
    save_report(comparison)  # a second report takes the place of the first
    (whole,) = comparison.folder.glob("events.out.tfevents.*.hparams")
    content = EventAccumulator(str(whole)).Reload().SummaryMetadata(EXPERIMENT_TAG)
    experiment = parse_experiment_plugin_data(content.plugin_data.content)
    names = [info.name for info in experiment.hparam_infos]
    assert names == ["variant", "seed", "drive.kind", "window", "drive.source"]
    assert list(experiment.hparam_infos[4].domain_discrete) == ["none", "region"]
    tags = [info.name.tag for info in experiment.metric_infos]
    assert "measures/error" in tags
    run = comparison.folder / "narrow" / "seeds-000-002"
    (own,) = run.glob("events.out.tfevents.*.hparams")
    events = EventAccumulator(str(own)).Reload()
    content = events.SummaryMetadata(SESSION_START_INFO_TAG)
    start = parse_session_start_info_plugin_data(content.plugin_data.content)
    assert start.hparams["variant"].string_value == "narrow"
    assert start.hparams["window"].number_value == 75
    assert start.hparams["seed"].string_value == "100 to 102"
    (value,) = events.Scalars("measures/n_regions")
    assert (value.value, value.step) == (load_run(run).summary["n_regions"], 1500)


def test_without_a_run_that_has_ended_there_is_no_report(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="must hold a run that has ended"):
        save_report(Comparison(tmp_path, VARIANTS))


@pytest.mark.parametrize("n_variants", [1, 3, 9])
def test_pictures_hold_what_is_there(runs: dict[str, list[Run]], n_variants: int) -> None:
    curves = {f"variant {n}": Curves.of(runs["wide"]) for n in range(n_variants)}
    for figure in (draw_shares(curves), draw_errors(curves)):
        panels = figure.axes
        assert all(len(panel.lines) == n_variants for panel in panels)
        styles = {(line.get_color(), line.get_linestyle()) for line in panels[0].lines}
        assert len(styles) == n_variants
    curves["variant 0"].errors[:2, 0, 1] = np.nan  # a robot that was not there
    curves["variant 0"].errors[3, :, 1] = np.nan
    draw_errors(curves)
    pairs = {f"variant {n} over 0": Estimate(0.6, 0.4, 0.9, 5) for n in range(n_variants)}
    figure = draw_improvements({f"measure {n}": pairs for n in range(5)})
    assert sum(panel.get_visible() for panel in figure.axes) == 5


def test_bands_that_reach_0_end_at_the_edge(runs: dict[str, list[Run]]) -> None:
    curves = {"wide": Curves.of(runs["wide"])}
    curves["wide"].errors[2, 0] = 99.0  # so far off the others that the interval holds 0
    (panel, *_) = draw_errors(curves).axes
    bottom, _ = panel.get_ylim()
    (band,) = panel.collections
    lowest = np.concatenate([path.vertices for path in band.get_paths()])[:, 1].min()
    assert 0 < bottom == pytest.approx(lowest)
    curves["wide"].errors[:] = 0.0
    assert {panel.get_yscale() for panel in draw_errors(curves).axes} == {"linear"}
