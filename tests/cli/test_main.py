"""How the program starts: it answers at once what it can, and imports no more than it needs."""

import json
import os
import re
import signal
import subprocess
import sys
from itertools import cycle
from pathlib import Path

import pytest

import torch_iac
from tests.cli.test_cli import typed
from torch_iac.cli import commands, typos
from torch_iac.cli import main as cli
from torch_iac.cli.options import Train, experiment_of
from torch_iac.kinds import CHOICES, DRIVES, EXPERTS

HEAVY = {
    *("torch", "numpy", "scipy", "matplotlib", "PIL", "pyarrow", "gymnasium", "pybullet"),
    *("tensorboard", "tyro", "tqdm"),
}


def modules_after(code: str) -> set[str]:
    """Return which packages a fresh Python has imported after some code, whatever that prints."""
    told = "import sys, json; sys.stderr.write(json.dumps([*sys.modules]))"
    words = [sys.executable, "-c", f"{code}\n{told}"]
    answer = subprocess.run(words, capture_output=True, text=True, timeout=900, check=True)
    return {name.partition(".")[0] for name in json.loads(answer.stderr)}


# What is said at once.


@pytest.mark.parametrize("word", ["--help", "-h"])
def test_help_says_of_each_command_what_it_does(word: str) -> None:
    answer = typed(word)
    assert (answer.code, answer.err) == (0, "")
    for name, what in cli.COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(what)}$", answer.out, re.MULTILINE)


def test_each_command_says_of_itself_what_the_help_says_of_it() -> None:
    kinds = {"train": Train, **commands.KINDS}
    assert list(kinds) == list(cli.COMMANDS)
    for name, kind in kinds.items():
        assert kind.__doc__
        assert kind.__doc__.partition("\n")[0] == cli.COMMANDS[name]
        assert cli.COMMANDS[name] in " ".join(typed(name, "--help").out.split())


def test_the_version_is_that_of_the_package() -> None:
    assert typed("--version").out == f"torch-iac {torch_iac.__version__}\n"
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", torch_iac.__version__)


@pytest.mark.parametrize(
    ("words", "end"),
    [
        ("", "got none"),
        ("--steps 3", "got --steps"),
        ("trian --steps 3", "got trian; perhaps you meant train"),
        ("figure runs/a", "got figure; perhaps you meant figures"),
    ],
)
def test_a_mistyped_command_is_answered_with_what_was_perhaps_meant(words: str, end: str) -> None:
    there = "train, resume, compare, figures, replay, export"
    sentence = f"the command must be one of {there}, {end} (see torch-iac --help)"
    answer = typed(*words.split())
    assert (answer.code, answer.out, answer.err) == (2, "", f"torch-iac: {sentence}\n")


# Mistyped options.


@pytest.mark.parametrize(
    "words",
    [
        "--step 3",
        "--agents 2 --step 3 --seed 1",
        "--hunger",
        "--epsilom=0.1",
        "--drive curriculum --drive.stages.1.dimensio sound",
        "--hungers -3 x - --steps 4",
        "--max_example 30",
    ],
)
def test_a_mistyped_option_is_answered_as_the_parser_would(words: str) -> None:
    with pytest.raises(ValueError, match="Unrecognized options") as quick:
        typos.check_options(words.split())
    with pytest.raises(ValueError, match="Unrecognized options") as parsed:
        experiment_of(words.split())
    what, of_parser = (re.split(r"; | \(", str(refusal.value))[0] for refusal in (quick, parsed))
    assert what == of_parser
    assert typed("train", *words.split()).err == f"torch-iac: {quick.value}\n"


def test_what_was_perhaps_meant_is_said() -> None:
    said = typed("train", "--max-exampels", "30").err
    assert said == (
        "torch-iac: Unrecognized options: --max-exampels, 30; perhaps you meant --max-examples "
        "(see torch-iac train --help)\n"
    )


@pytest.mark.parametrize(
    ("drive", "experts", "choice"), [*zip(DRIVES, cycle(EXPERTS), cycle(CHOICES), strict=False)]
)
def test_every_option_that_the_parser_knows_is_known(drive: str, experts: str, choice: str) -> None:
    words = ["--drive", drive, "--experts", experts, "--choice", choice]
    names = set(re.findall(r"--[a-z][\w.-]*", typed("train", *words, "--help").out))
    assert {"--help", "--max-examples", "--no-mp"} <= names
    typos.check_options(sorted(names))


@pytest.mark.parametrize(
    "words",
    [
        "--steps -5",
        "--max_examples 30",
        "--no-mp --drive=error",
        "--out - --seed 1",
        "-- --whatever",
    ],
)
def test_what_the_parser_may_take_is_left_to_it(words: str) -> None:
    typos.check_options(words.split())


def test_without_source_all_is_left_to_the_parser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(typos, "DECLARING", ())
    typos.check_options(["--hunger", "3"])


# What is imported.


@pytest.mark.parametrize(
    "words", [["--help"], ["--version"], ["trian"], ["train", "--step", "3"], []]
)
def test_what_is_answered_at_once_needs_nothing_heavy(words: list[str]) -> None:
    code = "from torch_iac.cli.main import main\nimport contextlib, io\n"
    code += "with contextlib.suppress(SystemExit), contextlib.redirect_stderr(io.StringIO()):\n"
    assert not modules_after(f"{code}    main({words})") & HEAVY


def test_options_of_the_other_commands_are_read_without_pytorch() -> None:
    imported = modules_after(
        "from torch_iac.cli.commands import parse; parse(['figures', 'runs/a'])"
    )
    assert not imported & HEAVY


def test_the_library_imports_what_is_used() -> None:
    assert not modules_after("import torch_iac") & HEAVY


def test_what_trains_needs_neither_scipy_nor_matplotlib() -> None:
    assert not modules_after("import torch_iac.cli.dispatch") & {
        "scipy.stats",
        "matplotlib",
        "pybullet",
    }


def test_every_public_name_is_there_and_listed() -> None:
    names = dir(torch_iac)
    assert {"IAC", "IACConfig", "Experiment", "train", "__version__"} <= set(names)
    assert all(getattr(torch_iac, name) is not None for name in names)
    assert not hasattr(torch_iac, "Hunger")


# Ctrl-C.


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is a signal only there")
def test_ctrl_c_while_it_starts_leaves_no_traceback(tmp_path: Path) -> None:
    interrupts = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(30)\n"
    (tmp_path / "torch.py").write_text(interrupts)
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    answer = subprocess.run(
        [sys.executable, "-m", "torch_iac", "train", "--steps", "3"],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
        # Whoever started the tests may have them ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert (answer.returncode, answer.stdout) == (130, "")
    assert answer.stderr == "torch-iac: interrupted\n"
