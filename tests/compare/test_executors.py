"""Processes that carry out runs: one that ends badly takes only its own run with it."""

import os
import threading
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest

from tests.lives import live
from torch_iac.compare.executors import carry_out, lock_file, on_processes, run_job
from torch_iac.compare.plan import Job
from torch_iac.internal.bars import tqdm


def job(folder: Path, word: str, number: int = 0) -> Job:
    """A run that ends as the word says."""
    run = folder / word / f"seed-{number:03d}"
    return Job(word, (number,), run, {"end": word}, str(folder))


def states(*jobs: Job) -> list[str]:
    """How far some runs are."""
    return [of.state for of in jobs]


def test_every_run_ends_in_its_own_way(tmp_path: Path) -> None:
    words = ["fine", "fail", "die", "exit", "stop", "fine"]
    jobs = [job(tmp_path, word, number) for number, word in enumerate(words)]
    sizes = dict.fromkeys(jobs, 10)
    assert carry_out(sizes, on_processes(jobs, live, 1), stop=lambda: False)
    assert states(*jobs) == ["done", "failed", "failed", "failed", "open", "done"]
    assert [of.reason for of in jobs[1:4]] == [
        "no luck at all",
        "its process was killed by SIGKILL",
        "its process ended with exit code 3",
    ]
    log = jobs[1].log.read_text()
    assert log.splitlines()[0].endswith(": fail/seed-001")
    assert "it has begun" in log
    assert "RuntimeError: no luck" in log


def test_who_wants_to_stop_is_heard(tmp_path: Path) -> None:
    jobs = [job(tmp_path, "fine", number) for number in range(40)]
    ended = on_processes(jobs, live, 1)
    assert not carry_out(dict.fromkeys(jobs, 1), ended, stop=lambda: True)
    assert states(*jobs).count("done") < 40
    assert set(states(*jobs)) <= {"done", "open"}


def test_a_failure_is_forgotten_when_the_run_is_tried_again(tmp_path: Path) -> None:
    bad = job(tmp_path, "fail")
    run_job(bad, live)
    assert states(bad) == ["failed"]
    run_job(replace(bad, content={"end": "fine"}), live)
    assert states(bad) == ["done"]


def test_what_is_done_is_not_done_again(tmp_path: Path) -> None:
    good = job(tmp_path, "fine")
    run_job(good, live)
    log = good.log.read_text()
    run_job(good, live)
    assert good.log.read_text() == log


@pytest.mark.skipif(os.name != "posix", reason="locks are of that kind only there")
def test_a_run_that_another_process_is_at_is_left_alone(tmp_path: Path) -> None:
    mine = job(tmp_path, "fine")
    mine.log.parent.mkdir(parents=True)
    with mine.log.open("a") as file, lock_file(file):
        run_job(mine, live)
    assert states(mine) == ["open"]
    assert "another process is at the run" in mine.log.read_text()
    run_job(mine, live)
    assert states(mine) == ["done"]


def test_nothing_is_left_running(tmp_path: Path) -> None:
    before = threading.active_count()
    jobs = [job(tmp_path, "fine")]
    carry_out({jobs[0]: 1}, on_processes(jobs, live, 4), stop=lambda: False)
    assert threading.active_count() == before


def test_a_bar_takes_no_semaphore_that_a_killed_process_would_leave() -> None:
    with mock.patch("multiprocessing.resource_tracker.register", side_effect=AssertionError):
        tqdm(disable=None).close()
    assert isinstance(tqdm.get_lock(), type(threading.RLock()))
