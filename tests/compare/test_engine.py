"""Experiments times seeds from Python, as `torch-iac compare` carries them out."""

from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest

from tests.cli.test_cli import typed
from torch_iac import Experiment, IACConfig, Random, StoppedError, resume
from torch_iac.analysis import generalisation
from torch_iac.analysis.generalisation import load_tests
from torch_iac.compare.engine import run_variants
from torch_iac.compare.plan import Job, Variant, load_comparison, plan_comparison

KNN = Experiment(world="kinematic", config=IACConfig(meta=None), steps=20)
RANDOM = replace(KNN, config=IACConfig(drive=Random(), meta=None))


def test_experiments_times_seeds_are_a_comparison(tmp_path: Path) -> None:
    runs = run_variants(tmp_path, {"knn": KNN, "random": RANDOM}, n_seeds=3, block=2, processes=1)
    assert {name: [run.seeds for run in of] for name, of in runs.items()} == {
        "knn": [(0, 1), (2,)],
        "random": [(0, 1), (2,)],
    }
    assert all(run.n_decisions == 20 for of in runs.values() for run in of)
    # Some of what is there already is read without being run again, and the plan keeps the rest.
    with mock.patch("torch_iac.experiment.train", side_effect=AssertionError):
        again = run_variants(tmp_path, {"random": RANDOM}, n_seeds=3, block=2, processes=1)
    assert [run.folder for run in again["random"]] == [run.folder for run in runs["random"]]
    assert [of.name for of in load_comparison(tmp_path).variants] == ["knn", "random"]
    answer = typed("compare", tmp_path, "--processes", "1")
    assert (answer.code, answer.err) == (0, "")
    assert "4 runs: 4 done." in answer.out


def fail(job: Job) -> None:
    raise RuntimeError(f"no luck with {job.seeds}")


def test_a_run_that_fails_is_named(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"knn/seed-000 failed: no luck with \(0,\)"):
        run_variants(tmp_path, {"knn": KNN}, n_seeds=1, processes=1, make=fail)


def test_what_is_refused_leaves_nothing(tmp_path: Path) -> None:
    bad = replace(KNN, world_options={"smell": 1})
    with pytest.raises(ValueError, match=r"variant knn: .*smell"):
        run_variants(tmp_path / "a", {"knn": bad}, n_seeds=1)
    assert not (tmp_path / "a").exists()


def test_other_numbers_in_the_same_folder_are_refused(tmp_path: Path) -> None:
    plan_comparison(tmp_path, [Variant("knn", KNN)], n_seeds=1).save()
    with pytest.raises(ValueError, match=r"steps of knn must stay 20, .* got 30"):
        run_variants(tmp_path, {"knn": replace(KNN, steps=30)}, n_seeds=1, processes=1)


def test_a_run_that_is_stopped_and_resumed_has_the_tests_of_one_that_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(generalisation, "N_TESTED", 5)
    experiment = replace(KNN, seeds=(0, 1), test_every=4, checkpoint_every=3)
    whole = experiment.run(tmp_path / "whole")
    asked = iter([False] * 9 + [True])
    with pytest.raises(StoppedError):
        experiment.run(tmp_path / "stopped", stop=lambda: next(asked))
    resumed = resume(tmp_path / "stopped")
    tests = load_tests(whole)
    assert tests == load_tests(resumed)
    rows = [(row["step"], row["seed"], row["set"]) for row in tests.to_pylist()]
    assert rows == [(4 * i, s, w) for i in range(1, 6) for w in ("met", "anywhere") for s in (0, 1)]


def test_tests_are_for_the_toy_rooms() -> None:
    with pytest.raises(ValueError, match="test_every must be 0 outside of the toy rooms, got 5"):
        Experiment(world="Pendulum-v1", test_every=5)
