"""Variants times seeds: the plan, the command, and what is left when something goes wrong."""

import json
import os
import re
import signal
import subprocess
import sysconfig
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from tests.cli.test_cli import Answer, train, typed
from torch_iac import Experiment, IACConfig, Random
from torch_iac.compare.plan import Comparison, Variant, load_comparison, part_of
from torch_iac.runs.reader import load_run

SCRIPT = Path(sysconfig.get_path("scripts")) / "torch-iac"
SMALL = ("--world", "kinematic", "--no-mp", "--steps", "30")
KNN = Variant("knn", Experiment(steps=9))
RANDOM = Variant(
    "random", Experiment(steps=9, config=IACConfig(drive=Random())), ("--drive", "random")
)


def compare(folder: Path, *words: str | Path, runs: tuple[str, ...] = SMALL) -> Answer:
    """Return the answer to a comparison; its processes are few, since they cost seconds."""
    return typed("compare", folder, "--processes", "1", *words, "--", *runs)


# The plan.


def test_jobs_are_variants_times_seeds_seed_by_seed(tmp_path: Path) -> None:
    jobs = Comparison(tmp_path, (KNN, RANDOM), ("--steps", "9"), n_seeds=2, seed=5).jobs()
    names = ["knn/seed-005", "random/seed-005", "knn/seed-006", "random/seed-006"]
    assert [job.name for job in jobs] == names
    experiment = Experiment.from_json(jobs[1].content)
    assert experiment == replace(RANDOM.experiment, seeds=(5,))
    assert jobs[1].folder == tmp_path / "random" / "seed-005"


def test_a_block_of_seeds_is_one_population(tmp_path: Path) -> None:
    jobs = Comparison(tmp_path, (KNN,), n_seeds=5, block=2).jobs()
    assert [job.seeds for job in jobs] == [(0, 1), (2, 3), (4,)]
    assert [job.folder.name for job in jobs] == ["seeds-000-001", "seeds-002-003", "seeds-004-004"]
    assert jobs[1].content["seeds"] == [2, 3]


def test_parts_of_an_array_job_share_all_runs_out(tmp_path: Path) -> None:
    jobs = Comparison(tmp_path, (KNN, RANDOM), n_seeds=5).jobs()
    parts = [part_of(jobs, f"{number}/3") for number in (1, 2, 3)]
    assert sorted(job.name for part in parts for job in part) == sorted(job.name for job in jobs)
    assert {len(part) for part in parts} == {3, 4}


def test_a_plan_is_read_back(tmp_path: Path) -> None:
    plan = Comparison(tmp_path, (KNN, RANDOM), ("--steps", "9"), n_seeds=3, seed=7, block=2)
    plan.save()
    assert load_comparison(tmp_path) == plan
    assert [path.name for path in tmp_path.iterdir()] == ["comparison.json"]


def test_a_comparison_grows(tmp_path: Path) -> None:
    plan = Comparison(tmp_path, (KNN,), ("--steps", "9"), n_seeds=3)
    grown = plan.grown((RANDOM,), n_seeds=5)
    assert grown == Comparison(tmp_path, (KNN, RANDOM), ("--steps", "9"), n_seeds=5)
    assert plan.grown((KNN,), ("--steps", "9")) == plan


# Bad input.

BAD_WORDS = [
    ("", "a comparison must have variants (--variant or --variants), got none"),
    ("--variant=knn", "a variant must be written NAME: WORDS, got knn"),
    (
        "--variant=../a:",
        "a variant's name must be letters, digits and _.+=-, and not figures, got '../a'",
    ),
    (
        "--variant=figures:",
        "a variant's name must be letters, digits and _.+=-, and not figures, got 'figures'",
    ),
    ("--variant=a: --variant=a:", "a variant's name must stand once, got a again"),
    (
        "--variant=a:--seed=3",
        "variant a must leave --seed, --agents, --out to torch-iac compare, got --seed=3",
    ),
    ("--variant=a: --seeds=0", "seeds must lie in [1, 100000], got 0"),
    ("--variant=a: --seed=-1", "seed must be at least 0, got -1"),
    (
        "--variant=a: --block=65",
        "block must lie in [1, 64], the robots that a run's summary lists, got 65",
    ),
    ("--variant=a: --processes=0", "processes must be at least 1, got 0"),
    ("--variant=a: --only=3/2", "only must be written I/N, with I in [1, N], got 3/2"),
    ("--variant=a: --variant=b:--hunger=3", "variant b: Unrecognized options: --hunger=3"),
    ("--variant=a:--epsilon=2", "variant a: epsilon must lie in [0, 1], got 2.0"),
    ("--variant=a:--log-every=0", "variant a: log_every must be at least 1, got 0"),
    ("--variant=a:--help", "variant a: words must be options of torch-iac train, got --help"),
    (
        "--variant=a:--outcomes=smell",
        "variant a: outcomes must be sensors (wall_0, wall_1, wall_2, wall_3, wall_4, wall_5, "
        "wall_6, wall_7, toy_distance, toy_cos, toy_sin), got smell",
    ),
    ("--variant=a:--world-options=beams=4.5", "variant a: beams must be a whole number, got 4.5"),
    ("--variant=a:--device=abacus", "variant a: device must be one that this machine has, got"),
]


@pytest.mark.parametrize(("words", "sentence"), BAD_WORDS)
def test_bad_words_are_refused_before_anything_runs(
    tmp_path: Path, words: str, sentence: str
) -> None:
    answer = compare(tmp_path / "a", *words.split())
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith(f"torch-iac: {sentence}")
    assert answer.err.count("\n") == 1
    assert not (tmp_path / "a").exists()


def test_variants_can_be_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "variants.json"
    file.write_text('{"knn": [], "random": "--drive random"}')
    answer = compare(tmp_path / "a", "--variants", file, "--seeds=1")
    assert (answer.code, answer.err) == (0, "")
    variants = load_comparison(tmp_path / "a").variants
    drives = [type(variant.experiment.config.drive).__name__ for variant in variants]
    assert drives == ["Progress", "Random"]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("[1]", "variants must be names, each with words, got [1]"),
        ('{"a": [1]}', "the words of a must be a list of texts, got [1]"),
        (
            '{"a": "--experts.k \'1"}',
            "the words of variant a cannot be read (No closing quotation): --experts.k '1",
        ),
        ('{"a": [], "a": []}', "JSON must be whole and strict: a name must stand once, got 'a'"),
    ],
)
def test_a_bad_file_is_refused(tmp_path: Path, content: str, sentence: str) -> None:
    file = tmp_path / "variants.json"
    file.write_text(content)
    answer = compare(tmp_path / "a", "--variants", file)
    assert answer.code == 2
    assert answer.err.startswith(f"torch-iac: {file} cannot be read: {sentence}")


# The command.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A comparison of two variants with two seeds each."""
    folder = tmp_path_factory.mktemp("comparisons") / "a"
    answer = compare(folder, "--seeds", "2", "--variant", "knn:", "--variant=random:--drive random")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.splitlines() == [
        "4 runs: 4 done.",
        f"Read {folder}/report.md, or: tensorboard --logdir {folder}",
    ]
    return folder


def test_each_run_is_what_train_makes_of_its_words(folder: Path, tmp_path: Path) -> None:
    run = load_run(folder / "random" / "seed-001")
    words = (*SMALL[:-2], "--drive", "random", "--seed", "1")
    alone = train(tmp_path / "a", *words, steps=30)
    assert run.steps == alone.steps
    assert run.config["iac"] == alone.config["iac"]
    drives = [load_run(job).config["iac"]["drive"]["kind"] for job in folder.glob("*/seed-001")]
    assert sorted(drives) == ["Progress", "Random"]


def test_what_is_done_is_not_run_again_and_more_seeds_can_be(folder: Path) -> None:
    def times() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in folder.rglob("steps/*.parquet")}

    before = times()
    answer = typed("compare", folder, "--seeds", "3", "--processes", "1")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.startswith("6 runs: 6 done.")
    assert len(times()) == 6
    assert times().items() > before.items()


def test_a_part_of_the_runs_makes_no_report_before_it_is_asked_for(tmp_path: Path) -> None:
    words = ("--variant=a:", "--variant=b:--drive random", "--seeds=1")
    answer = compare(tmp_path / "a", *words, "--only=2/2")
    assert (answer.code, answer.out) == (0, "1 run: 1 done.\n")
    assert not (tmp_path / "a" / "report.md").exists()
    answer = typed("compare", tmp_path / "a", "--report")
    assert (answer.code, answer.out.splitlines()[0]) == (0, "2 runs: 1 done, 1 not begun.")
    assert not (tmp_path / "a" / "a").exists()
    assert "\n- a/seed-000: not begun\n" in (tmp_path / "a" / "report.md").read_text()


def test_a_run_that_fails_is_told_of_and_the_others_go_on(tmp_path: Path) -> None:
    words = ("--seeds=1", "--variant=huge:--steps 999999999", "--variant=small:--steps 20")
    answer = compare(tmp_path / "a", *words, runs=("--world", "kinematic"))
    assert answer.code == 1
    assert answer.out.startswith("2 runs: 1 done, 1 failed.")
    reason = r"a run must fit into memory: 1 agents and 999,999,999 decisions need about .*"
    assert re.fullmatch(rf"torch-iac: huge/seed-000 failed: {reason}\n", answer.err)
    report = (tmp_path / "a" / "report.md").read_text()
    assert re.search(rf"- huge/seed-000 failed: {reason} \(`huge/seed-000\.log`\)", report)
    assert pq.read_table(tmp_path / "a" / "measures.parquet")["variant"].to_pylist() == ["small"]


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("--variant=knn:--experts.k 2",), "iac.experts.k of knn must stay 1"),
        (("--block=2",), "block must stay `1`"),
        (("--", "--steps", "9"), f"the words for all must stay `{' '.join(SMALL)}`"),
    ],
)
def test_what_a_comparison_began_with_stays(
    folder: Path, words: tuple[str, ...], what: str
) -> None:
    answer = typed("compare", folder, *words)
    assert answer.code == 2
    assert answer.err.startswith(f"torch-iac: {what}, as {folder} began, got")


def test_a_folder_with_another_run_is_refused(tmp_path: Path) -> None:
    train(tmp_path / "a" / "knn" / "seed-000", "--world", "kinematic")
    answer = compare(tmp_path / "a", "--variant=knn:", "--seeds=1")
    assert answer.code == 2
    assert re.search("seed-000 must hold the run of knn/seed-000, with .*, got", answer.err)


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is a signal only there")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_comparison_that_is_stopped_goes_on(tmp_path: Path, number: signal.Signals) -> None:
    words = [*SMALL[:-1], "300"]
    folder = tmp_path / "a"
    begun = folder / "a" / "seed-000" / "checkpoints" / "LATEST"
    command = [SCRIPT, "compare", folder, "--seeds=1", "--variant=a:--checkpoint-every 20"]
    process = subprocess.Popen(
        [*map(str, command), "--", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Whoever started the tests may have them ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    give_up = time.monotonic() + 120
    while not begun.exists() and process.poll() is None and time.monotonic() < give_up:
        time.sleep(0.05)
    process.send_signal(number)
    out, err = process.communicate(timeout=900)
    assert (process.returncode, out) == (128 + number, "")
    said = f"torch-iac: stopped; go on with: torch-iac compare {folder}"
    assert err.splitlines()[-1] == said, err
    assert "Traceback" not in err
    assert not (folder / "a" / "seed-000" / "summary.json").exists()
    answer = typed("compare", folder, "--processes", "1")
    assert (answer.code, answer.err) == (0, "")
    alone = train(tmp_path / "alone", *words[:-2], steps=300)
    assert load_run(folder / "a" / "seed-000").steps == alone.steps
    log = (folder / "a" / "seed-000.log").read_text()
    assert len(re.findall(r"^\d{4}-.*, process \d+: a/seed-000", log, re.MULTILINE)) == 2


def config_of(folder: Path) -> dict[str, Any]:
    """Return a plan as it is on disk."""
    content: dict[str, Any] = json.loads((folder / "comparison.json").read_text())
    return content


def test_the_plan_says_what_was_asked_for(folder: Path) -> None:
    variants = config_of(folder)["variants"]
    assert {name: of["words"] for name, of in variants.items()} == {
        "knn": [],
        "random": ["--drive", "random"],
    }
    assert variants["random"]["experiment"]["iac"]["drive"] == {"kind": "Random"}
    assert config_of(folder)["words"] == list(SMALL)
