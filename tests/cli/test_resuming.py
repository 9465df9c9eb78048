"""A run that was stopped, killed or spoilt goes on as the run that would have been."""

import math
import resource
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.same_run import differences
from torch_iac import training
from torch_iac.cli.main import main
from torch_iac.internal.stop_signals import stopping
from torch_iac.runs.checkpoint import Checkpoints
from torch_iac.runs.reader import load_run
from torch_iac.runs.schema import CHECKPOINTS

N_DECISIONS = 90
WORDS = [
    *("--steps", str(N_DECISIONS), "--max-examples", "15", "--window", "5", "--delay", "5"),
    *("--n-candidates", "5", "--log-every", "4", "--checkpoint-every", "7"),
]
KINDS = {
    "toyroom": ["--world", "toyroom"],
    "toyroom-mlp": ["--world", "toyroom", "--experts", "mlp", "--shadows", "knn"],
    "kinematic": ["--world", "kinematic", "--agents", "3", "--recorded-rows", "0"],
    "kinematic-mlp": ["--world", "kinematic", "--experts", "mlp", "--drive", "meta_progress"],
    "global": ["--world", "kinematic", "--drive", "global_progress"],
    "improvement": ["--world", "kinematic", "--drive", "improvement", "--choice", "softmax"],
}


class Killed(BaseException):
    """Stands for a process that is no more: nothing catches it, and nothing is tidied up."""


@pytest.fixture(autouse=True)
def _no_thrift(monkeypatch: pytest.MonkeyPatch) -> None:
    """Checkpoints are written when they are due, whatever they cost."""
    monkeypatch.setattr(training, "SHARE_FOR_CHECKPOINTS", math.inf)


@pytest.fixture(scope="module", params=KINDS, ids=str)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing disturbed."""
    folder: Path = tmp_path_factory.mktemp(request.param) / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "SHARE_FOR_CHECKPOINTS", math.inf)
        main(["train", *KINDS[request.param], *WORDS, "--out", str(folder)])
    return folder


def begin(whole: Path, folder: Path) -> list[str]:
    """The words of the same run in another folder."""
    words: list[str] = load_run(whole).config["command"][1:]
    return [*words[:-1], str(folder)]


def die_at(monkeypatch: pytest.MonkeyPatch, decision: int) -> None:
    """Let the process end before a decision is recorded, as `kill -9` does."""
    from torch_iac.runs.recorder import Recorder

    record = Recorder.record

    def dies(self: Recorder, step: Any, zones: Any = None) -> None:
        if step.number == decision:
            monkeypatch.setattr(Recorder, "record", record)
            monkeypatch.setattr(Recorder, "flush", lambda _: None)  # nor is anything written
            raise Killed
        record(self, step, zones)

    monkeypatch.setattr(Recorder, "record", dies)


def check_same(folder: Path, whole: Path) -> None:
    assert differences(folder, whole) == []


@pytest.mark.parametrize("decision", [0, 7, 61])
def test_a_killed_run_goes_on_to_the_bit(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decision: int
) -> None:
    folder = tmp_path / "killed"
    die_at(monkeypatch, decision)
    with pytest.raises(Killed):
        main(begin(whole, folder))
    monkeypatch.undo()
    monkeypatch.setattr(training, "SHARE_FOR_CHECKPOINTS", math.inf)
    main(["resume", str(folder)])
    check_same(folder, whole)


@pytest.fixture
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("small") / "whole"
    main(["train", "--world", "kinematic", "--agents", "2", *WORDS, "--out", str(folder)])
    return folder


def stopped(folder: Path, whole: Path, number: int, decision: int) -> int:
    """Send a signal to a run at a decision; return its exit code."""
    from torch_iac.agent import IAC

    observe: Callable[..., Any] = IAC.observe

    def interrupted(self: IAC, sensors: Any) -> Any:
        if self.n_decisions == decision:
            signal.raise_signal(number)
        return observe(self, sensors)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IAC, "observe", interrupted)
        with pytest.raises(SystemExit) as end:
            main(begin(whole, folder))
    assert isinstance(end.value.code, int)
    return end.value.code


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_run_that_is_asked_to_stop_says_how_to_go_on(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], number: int, code: int
) -> None:
    folder = tmp_path / "stopped"
    assert stopped(folder, small, number, 40) == code
    words = f"stopped after decision 41; go on with: torch-iac resume {folder}"
    assert words in capsys.readouterr().err
    assert load_run(folder).n_decisions == 41  # what was acknowledged can be read
    main(["resume", str(folder)])
    check_same(folder, small)


def test_a_run_can_go_on_beyond_its_end(small: Path, tmp_path: Path) -> None:
    folder = tmp_path / "longer"
    words = begin(small, folder)
    words[words.index("--steps") + 1] = "50"
    main(words)
    for words in ([], ["--steps", "50"], ["--steps", "0"]):
        with pytest.raises(SystemExit) as end:
            main(["resume", str(folder), *words])
        assert end.value.code == 2
    main(["resume", str(folder), "--steps", str(N_DECISIONS)])
    check_same(folder, small)
    assert load_run(folder).config["steps"] == N_DECISIONS


def test_a_run_that_was_killed_after_its_last_decision_ends(small: Path, tmp_path: Path) -> None:
    from torch_iac.runs.recorder import Recorder

    folder = tmp_path / "unsummed"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Recorder, "close", die)
        with pytest.raises(Killed):
            main(begin(small, folder))
    main(["resume", str(folder)])
    check_same(folder, small)


def die(_: object) -> None:
    raise Killed


def test_a_damaged_checkpoint_is_noticed_and_the_one_before_is_used(
    small: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "damaged"
    assert stopped(folder, small, signal.SIGINT, 40) == 130
    state = max((folder / CHECKPOINTS).glob("*/state.safetensors"))
    data = bytearray(state.read_bytes())
    data[len(data) // 2] ^= 1
    state.write_bytes(data)
    with pytest.warns(UserWarning, match="is damaged, going on from 000000000035"):
        main(["resume", str(folder)])
    check_same(folder, small)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda folder: shutil.rmtree(folder), "holds no run"),
        (lambda folder: (folder / "config.json").write_text("[" * 10**6), "nested at most"),
        (lambda folder: (folder / "config.json").write_text("{}"), "it has no space"),
        (lambda folder: edit(folder, '"steps":', '"stops":'), "got stops"),
        (lambda folder: edit(folder, '"world":', '"word":'), "must be the run of an experiment"),
        (lambda folder: edit(folder, '_examples": 15', '_examples": 16'), "must be 15"),
    ],
)
def test_what_cannot_be_resumed_is_refused(
    small: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[Path], object],
    sentence: str,
) -> None:
    folder = tmp_path / "spoilt"
    assert stopped(folder, small, signal.SIGINT, 40) == 130
    spoil(folder)
    capsys.readouterr()
    with pytest.raises(SystemExit) as end:
        main(["resume", str(folder)])
    assert end.value.code == 2
    assert sentence in capsys.readouterr().err


def edit(folder: Path, old: str, new: str) -> None:
    path = folder / "config.json"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_an_error_in_the_world_leaves_what_was_there_readable(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from torch_iac_envs.kinematic import ToyRoomKinematic

    step = ToyRoomKinematic.step

    def fails(self: ToyRoomKinematic, actions: Any) -> Any:
        if self._moment == 60:
            raise OSError(28, "No space left on device", "somewhere")
        return step(self, actions)

    folder = tmp_path / "failed"
    with monkeypatch.context() as patch:
        patch.setattr(ToyRoomKinematic, "step", fails)
        with pytest.raises(SystemExit):
            main(begin(small, folder))
    run = load_run(folder)
    assert run.n_decisions == 59
    assert np.isfinite(run.column("error")).all()
    main(["resume", str(folder)])
    check_same(folder, small)


def test_checkpoints_keep_to_their_share_of_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []
    write = Checkpoints.write
    monkeypatch.setattr(training, "SHARE_FOR_CHECKPOINTS", 0.0)

    def noted(self: Checkpoints, checkpoint: Any) -> Path:
        written.append(checkpoint.n_decisions)
        return write(self, checkpoint)

    monkeypatch.setattr(Checkpoints, "write", noted)
    main(["train", "--world", "kinematic", *WORDS, "--out", str(tmp_path / "run")])
    assert written == [7, N_DECISIONS]  # none is affordable after the first, but the last is due


def test_a_second_signal_does_not_wait_for_the_decision_to_end() -> None:
    before = signal.getsignal(signal.SIGINT)
    with stopping() as stop:
        signal.raise_signal(signal.SIGTERM)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGINT) is before


def test_a_full_disk_is_one_sentence_and_the_run_goes_on_when_there_is_room(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "full"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # No file may be larger: the checkpoints grow beyond it after some decisions.
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, limits[1]))
    try:
        with pytest.raises(SystemExit) as end:
            main(begin(small, folder))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert end.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"torch-iac: File too large; go on with: torch-iac resume {folder}"
    )
    assert 0 < load_run(folder).n_decisions < N_DECISIONS
    main(["resume", str(folder)])
    check_same(folder, small)
