"""The example with a network, a drive and a world of a user's own, as its README has it."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import torch_iac as iac
from tests.same_run import differences

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "scripts" / "examples" / "own_parts"
WORDS = [
    *("--world", "lamp_world:LampWorld-v0", "--world-options", "reach=0.4"),
    *("--experts", "sine_network:SineNetwork", "--experts.width", "6"),
    *("--max-examples", "20", "--window", "5", "--delay", "5", "--no-mp"),
]
PROGRESS = re.compile(r"\d+ of \d+ decisions.*")
"""What a slow machine says of a run now and then."""

BORED = ["--drive", "boredom:Boredom", "--drive.weight", "0.02"]


def command(where: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder."""
    where.mkdir(exist_ok=True)
    return subprocess.run(
        [sys.executable, "-m", "torch_iac", *words],
        cwd=where,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )


def environment() -> dict[str, str]:
    paths = [str(ROOT), str(ROOT / "envs")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the example, somewhere else."""
    return shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("own") / "parts")


@pytest.fixture(scope="module")
def whole(here: Path) -> Path:
    """A run that nothing disturbed."""
    folder = here.parent / "whole"
    words = [*WORDS, *BORED, "--checkpoint-every", "10", "--steps", "300"]
    answer = command(here, "train", *words, "--out", str(folder))
    said = [line for line in answer.stderr.splitlines() if not PROGRESS.fullmatch(line)]
    assert (answer.returncode, said) == (0, [])
    return folder


def test_parts_of_ones_own_are_recorded_with_their_numbers(whole: Path) -> None:
    config = iac.load_run(whole).config
    assert config["iac"]["drive"] == {"kind": "boredom:Boredom", "weight": 0.02}
    module = {"kind": "sine_network:SineNetwork", "width": 6}
    assert config["iac"]["experts"]["module"] == module
    assert (config["world"], config["world_options"]) == (WORDS[1], {"reach": 0.4})
    assert list(config["space"]["actions"]) == ["speed", "lamp"]


@pytest.mark.skipif(os.name != "posix", reason="processes are killed by a signal only there")
def test_a_killed_run_goes_on_from_another_folder(here: Path, whole: Path) -> None:
    folder, elsewhere = here.parent / "killed", here.parent / "elsewhere"
    words = [*WORDS, *BORED, "--checkpoint-every", "10", "--steps", "300", "--out", str(folder)]
    process = subprocess.Popen(
        [sys.executable, "-m", "torch_iac", "train", *words], cwd=here, env=environment()
    )
    give_up = time.monotonic() + 120
    while len(list(folder.glob("checkpoints/*/state.safetensors"))) < 2:
        assert process.poll() is None
        assert time.monotonic() < give_up
        time.sleep(0.01)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    answer = command(elsewhere, "resume", str(folder))
    assert answer.returncode == 0, answer.stderr
    assert differences(folder, whole) == []


def test_it_is_replayed_from_another_folder(here: Path, whole: Path) -> None:
    film = here.parent / "film.gif"
    words = ["--at", "0", "290", "--decisions", "2", "--out", str(film)]
    answer = command(here.parent / "elsewhere", "replay", str(whole), *words)
    assert answer.returncode == 0, answer.stderr
    assert film.stat().st_size


def test_it_is_compared_over_seeds(here: Path) -> None:
    folder = here.parent / "compared"
    variants = ["--variant", f"bored: {' '.join(BORED)}", "--variant", "progress:"]
    words = ["--seeds", "2", "--processes", "2", "--", *WORDS, "--steps", "60"]
    answer = command(here, "compare", str(folder), *variants, *words)
    assert answer.returncode == 0, answer.stderr
    assert (folder / "report.md").exists()
    assert len(list(folder.glob("*/*/summary.json"))) == 4


def test_its_robots_can_be_asked(here: Path, whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(here)
    agent = iac.load_agent(whole)
    assert agent.n_decisions == 300
    predictions = agent.predict(np.array([[0.5, 1.0]]), np.array([[0.9, 0.0, 0.2]]))
    assert predictions.shape == (1, 1, 3)
    region = int(agent.region_summary().region[0])
    network = agent.expert(region)
    assert isinstance(network, torch.nn.Module)
    assert network(torch.zeros(2, 5)).shape == (2, 3)
