"""Runs on a Ray cluster of two nodes, on this machine; a worker that is killed loses nothing."""

import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cli.test_cli import train, typed
from torch_iac.runs.reader import load_run

WHY = "needs Ray: pip install 'torch_iac[ray]'"
cluster_utils: Any = pytest.importorskip("ray.cluster_utils", reason=WHY)
pytestmark = pytest.mark.filterwarnings("default")  # Ray has warnings of its own

WORDS = ("--world", "kinematic", "--no-mp", "--checkpoint-every", "20")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A cluster of two nodes, each with room for one run."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    room = {"num_cpus": 1, "object_store_memory": 100_000_000}
    cluster = cluster_utils.Cluster()
    try:
        cluster.add_node(**room, include_dashboard=False)
        cluster.add_node(**room)
    except Exception as error:
        cluster.shutdown()
        pytest.skip(f"Ray gives a node 15 seconds to start, too few here and now: {error}")
    yield cluster.address
    cluster.shutdown()


def kill_when_saved(run: Path) -> None:
    """Kill the process that is at a run, once it has a checkpoint."""
    give_up = time.monotonic() + 120
    while not (run / "checkpoints" / "LATEST").exists() and time.monotonic() < give_up:
        time.sleep(0.02)
    who = re.search(r", process (\d+):", run.with_name(f"{run.name}.log").read_text())
    assert who
    os.kill(int(who[1]), signal.SIGKILL)


def test_a_killed_worker_is_replaced_and_its_run_goes_on(address: str, tmp_path: Path) -> None:
    folder, steps = tmp_path / "a", 400
    killer = threading.Thread(target=kill_when_saved, args=(folder / "knn" / "seed-000",))
    killer.start()
    variants = ("--variant=knn:", "--variant=random: --drive random")
    words = (*WORDS, "--steps", str(steps))
    answer = typed("compare", folder, *variants, "--seeds=1", "--ray", address, "--", *words)
    killer.join()
    assert answer.code == 0, answer.err
    assert "2 runs: 2 done." in answer.out.splitlines()  # Ray, too, says what it has seen
    log = (folder / "knn" / "seed-000.log").read_text()
    assert len(re.findall(r"^\d{4}-.*, process \d+: knn/seed-000", log, re.MULTILINE)) == 2
    alone = train(tmp_path / "alone", *WORDS, steps=steps)
    assert load_run(folder / "knn" / "seed-000").steps == alone.steps


def test_a_run_that_fails_there_says_why(address: str, tmp_path: Path) -> None:
    words = ("--variant=huge:--steps 999999999", "--seeds=1", "--ray", address)
    answer = typed("compare", tmp_path / "a", *words, "--", "--world", "kinematic")
    assert (answer.code, answer.out) == (1, "1 run: 1 failed.\n"), answer.err
    assert "huge/seed-000 failed: a run must fit into memory" in answer.err


def test_a_cluster_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    words = ("--variant=a:", "--seeds=1", "--ray", "127.0.0.1:1")
    answer = typed("compare", tmp_path / "a", *words)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.splitlines()[-1].startswith("torch-iac: ray must be the address of a cluster")
    assert not (tmp_path / "a").exists()
