"""Streams that are not there, and readers that have gone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from torch_iac.runs.reader import load_run

PROGRAM = [sys.executable, "-m", "torch_iac"]
SHORT = ["train", "--world", "kinematic", "--steps", "5", "--n-candidates", "2", "--no-mp"]


@pytest.mark.parametrize("closed", ["2>&-", "<&- >&- 2>&-"])
def test_a_run_is_made_without_streams(tmp_path: Path, closed: str) -> None:
    program = [*PROGRAM, *SHORT, "--out", str(tmp_path / "a")]
    subprocess.run(["sh", "-c", f'"$@" {closed}', "sh", *program], check=True, timeout=120)
    assert load_run(tmp_path / "a").n_decisions == 5


def test_a_script_runs_without_streams(tmp_path: Path) -> None:
    script = "import torch_iac; torch_iac.Experiment(world='kinematic', steps=5).run('a')"
    program = [sys.executable, "-c", script]
    subprocess.run(["sh", "-c", '"$@" 2>&-', "sh", *program], cwd=tmp_path, check=True, timeout=120)
    assert load_run(tmp_path / "a").n_decisions == 5


@pytest.mark.parametrize("words", [["--help"], ["train", "--help"], ["--version"], ["trin"]])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_has_gone_ends_a_command_quietly(words: list[str], unbuffered: str) -> None:
    nobody, out = os.pipe()
    os.close(nobody)
    try:
        answer = subprocess.run(
            [*PROGRAM, *words],
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
            check=False,
        )
    finally:
        os.close(out)
    if words == ["trin"]:  # whose answer is on stderr
        assert (answer.returncode, answer.stderr.count("\n")) == (2, 1)
    else:
        assert answer.returncode in (0, 141)  # argparse itself is silent
        assert answer.stderr == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_an_answer_that_cannot_be_written_is_said_in_one_sentence() -> None:
    with Path("/dev/full").open("w") as full:
        answer = subprocess.run(
            [*PROGRAM, "--version"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert answer.returncode == 2
    assert answer.stderr == "torch-iac: the answer cannot be written: No space left on device\n"


ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.mark.parametrize(
    ("locale", "name"),
    [(ASCII, "rün".encode()), ({"LC_ALL": "C.UTF-8"}, b"r\xffn")],
    ids=["ASCII", "UTF-8"],
)
def test_a_run_folder_may_be_called_by_any_bytes(
    tmp_path: Path, name: bytes, locale: dict[str, str]
) -> None:
    folder = os.fsencode(tmp_path) + b"/" + name
    commands: list[list[str | bytes]] = [
        [*PROGRAM, *SHORT, "--out", folder],
        [*PROGRAM, "resume", folder, "--steps", "7"],
    ]
    for command in commands:
        answer = subprocess.run(
            command, env={**os.environ, **locale}, capture_output=True, timeout=90, check=False
        )
        assert (answer.returncode, b"torch-iac" in answer.stderr) == (0, False)
        assert b"Look at " + folder in answer.stdout
    assert load_run(Path(os.fsdecode(folder))).n_decisions == 7


def test_what_the_locale_cannot_write_is_escaped() -> None:
    answer = subprocess.run(
        [*PROGRAM, "train", "--world", "wörld\u2028"],
        env={**os.environ, **ASCII},
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert answer.returncode == 2
    assert "wörld".encode() in answer.stderr
    assert b"Traceback" not in answer.stderr
