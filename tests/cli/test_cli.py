"""The command `torch-iac`, as a user types it: mostly in this process, for speed."""

import hashlib
import io
import logging
import os
import re
import signal
import subprocess
import sys
import sysconfig
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import pyarrow.parquet as pq
import pytest
import torch
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image, ImageSequence

from tests.same_run import differences
from tests.synthetic_run import write_run
from torch_iac import (
    PRESETS,
    Error,
    Experiment,
    IACConfig,
    ImprovementPredictor,
    KNNExperts,
    MetaPredictor,
    MLPExperts,
    Softmax,
    Step,
    load_experiment,
)
from torch_iac.cli.main import main
from torch_iac.kinds import DRIVES
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.recorder import Recorder
from torch_iac_envs.kinematic import ToyRoomKinematic

SCRIPT = Path(sysconfig.get_path("scripts")) / "torch-iac"

SENSORS = [*(f"wall_{beam}" for beam in range(8)), "toy_distance", "toy_cos", "toy_sin"]
STEP_COLUMNS = [
    *("step", "agent", "seed", "zone", "random_action"),
    *(f"action/{name}" for name in ("left_wheel", "right_wheel", "sound")),
    *(f"sensor/{name}" for name in SENSORS),
    *("outcome/toy_distance", "prediction/toy_distance"),
    *("error", "expected_error", "region", "progress"),
]
REGION_COLUMNS = [
    *("agent", "region", "parent", "depth", "born_step", "split_step"),
    *("cut_dimension", "cut_value", "n_examples"),
]


@dataclass(frozen=True)
class Answer:
    """What a command leaves: its exit code and what it wrote."""

    code: int
    out: str
    err: str


def typed(*words: str | Path) -> Answer:
    """Return the answer to a command, on a wide terminal."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    wide = mock.patch.dict(os.environ, COLUMNS="240")
    with redirect_stdout(out), redirect_stderr(err), wide:
        try:
            main([str(word) for word in words])
        except SystemExit as end:
            code = int(end.code or 0)
    return Answer(code, out.getvalue(), err.getvalue())


def train(folder: Path, *words: str, steps: int = 5) -> Run:
    """Return the run of a command that must go well."""
    answer = typed("train", "--steps", str(steps), "--out", folder, *words)
    assert (answer.code, answer.err) == (0, "")
    return load_run(folder)


def fingerprints(folder: Path) -> dict[str, str]:
    """Return a hash of each file under a folder."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of 300 decisions, whose root was cut once."""
    return train(tmp_path_factory.mktemp("runs") / "a", steps=300)


# Good input.


def test_a_run_folder_is_whole(run: Run) -> None:
    files = {str(path.relative_to(run.folder)) for path in run.folder.rglob("*")}
    assert files >= {
        *("config.json", "regions.parquet", "summary.json"),
        *("steps/part-00000.parquet", "figures/experts.png", "figures/zones.png"),
    }
    assert len(list(run.folder.glob("events.out.tfevents.*"))) == 1
    steps = pq.read_table(run.folder / "steps")
    assert steps.column_names == STEP_COLUMNS
    assert steps["step"].to_pylist() == list(range(300))
    regions = pq.read_table(run.folder / "regions.parquet")
    assert regions.column_names == REGION_COLUMNS
    assert regions["split_step"].to_pylist() == [250, -1, -1]


def test_a_config_says_how_to_run_it_again(run: Run) -> None:
    config = run.config
    assert config["command"] == ["torch-iac", *f"train --steps 300 --out {run.folder}".split()]
    assert load_experiment(run.folder) == Experiment(steps=300)
    assert config["iac"] == IACConfig().to_json()
    assert set(config["versions"]) >= {"python", "torch_iac", "torch"}
    assert any(name.startswith("pybullet") for name in config["versions"])
    assert list(config["space"]["sensors"]) == SENSORS


def test_the_report_tells_what_happened_and_where_to_look(tmp_path: Path) -> None:
    answer = typed("train", "--steps", "300", "--out", tmp_path / "a")
    lines = answer.out.splitlines()
    assert re.fullmatch(
        r"The robot took 300 decisions in \d+ s \(\d+ a second\) and made 2 regions\.", lines[0]
    )
    assert re.fullmatch(r"First cut: \w+ at -?[\d.]+, at decision 250\.", lines[1])
    assert lines[2].startswith("Focus on f3: ")
    assert re.fullmatch(r"Time: f1 \d+%, f2 \d+%, f3 \d+%\.", lines[4])
    assert lines[5] == f"Look at {tmp_path / 'a' / 'figures'}, or: tensorboard --logdir {tmp_path}"


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_is_where_options_start_from(tmp_path: Path, preset: str) -> None:
    run = train(tmp_path / "a", "--preset", preset, "--no-mp")
    assert run.config["iac"] == replace(PRESETS[preset], meta=None).to_json()


def test_options_override_the_preset_wherever_they_stand(tmp_path: Path) -> None:
    words = "--epsilon 0.5 --experts.k 3 --preset iac2007 --delay=7 --no-inherit-history --no-mp"
    run = train(tmp_path / "a", *words.split())
    expected = replace(
        PRESETS["iac2007"],
        epsilon=0.5,
        delay=7,
        inherit_history=False,
        experts=KNNExperts(k=3),
        meta=None,
    )
    assert run.config["iac"] == expected.to_json()


@pytest.mark.parametrize("drive", DRIVES)
def test_every_drive_can_be_chosen(tmp_path: Path, drive: str) -> None:
    run = train(tmp_path / "a", "--drive", drive, steps=60)
    assert (
        run.config["iac"]["drive"]
        == IACConfig(
            drive=DRIVES[drive](), meta=MetaPredictor(), improvement=ImprovementPredictor()
        ).to_json()["drive"]
    )


def test_parts_have_options_of_their_own(tmp_path: Path) -> None:
    words = "--experts mlp --experts.hidden 8 --shadows knn mlp --drive error --drive.source meta"
    more = "--choice softmax --choice.temperature 0.5 --meta.memory 50"
    run = train(tmp_path / "a", *words.split(), *more.split(), steps=60)
    expected = IACConfig(
        experts=MLPExperts(hidden=(8,)),
        shadows={"knn": KNNExperts(), "mlp": MLPExperts()},
        drive=Error(source="meta"),
        choice=Softmax(temperature=0.5),
        meta=MetaPredictor(memory=50),
    )
    assert run.config["iac"] == expected.to_json()
    assert run.shadow_names == ("knn", "mlp")


def test_a_world_has_the_options_that_it_is_given(tmp_path: Path) -> None:
    options = ("beams=4", "sensor_noise=0", "toy-direction=false")
    run = train(tmp_path / "a", "--world-options", *options, steps=100)
    assert run.config["world_options"] == {
        "beams": 4,
        "sensor_noise": 0,
        "toy_direction": False,
    }
    names = [dimension.name for dimension in run.space.sensors]
    assert names == ["wall_0", "wall_1", "wall_2", "wall_3", "toy_distance"]
    in_the_robot = run.column("zone") == 2
    assert (run.column("outcome/toy_distance")[in_the_robot] == 0.0).all()  # no noise


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["wall_3", "toy_cos"], ["wall_3", "toy_cos"]), (["all"], SENSORS), ([], ["toy_distance"])],
)
def test_outcomes_are_the_sensors_asked_for(
    tmp_path: Path, words: list[str], expected: list[str]
) -> None:
    run = train(tmp_path / "a", "--outcomes", *words)
    assert [dimension.name for dimension in run.space.outcomes] == expected


def test_each_of_two_agents_lives_as_it_would_alone(tmp_path: Path) -> None:
    together = train(tmp_path / "both", "--agents", "2", "--seed", "7", steps=100)
    assert together.seeds == (7, 8)
    assert together.n_decisions == 100
    for agent, seed in enumerate(together.seeds):
        alone = train(tmp_path / str(seed), "--seed", str(seed), steps=100)
        assert together.table(agent=agent).drop("agent") == alone.steps.drop("agent")


def test_the_same_command_gives_the_same_run(run: Run, tmp_path: Path) -> None:
    again = train(tmp_path / "again", steps=300)
    assert again.steps == run.steps
    assert again.regions == run.regions
    other = train(tmp_path / "other", "--seed", "1", steps=300)
    assert other.steps != run.steps


def test_runs_get_a_folder_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert typed("train", "--steps", "5").code == 0
    (folder,) = (tmp_path / "runs").iterdir()
    assert re.fullmatch(r"\d{8}-\d{6}-toyroom", folder.name)
    assert load_run(folder).n_decisions == 5


def test_auto_is_a_device_that_is_there(tmp_path: Path) -> None:
    assert train(tmp_path / "a", "--device", "auto").config["device"] == "auto"


def test_the_kinematic_world_writes_the_same_run_folder(run: Run, tmp_path: Path) -> None:
    words = "--world kinematic --agents 3 --device auto --world-options sensor_noise=0"
    twin = train(tmp_path / "a", *words.split(), steps=300)
    assert twin.steps.column_names == run.steps.column_names
    assert twin.config["world"] == "kinematic"
    assert twin.config["world_options"] == {"sensor_noise": 0}
    assert (twin.n_agents, twin.n_recorded, twin.n_decisions) == (3, 3, 300)
    files = [
        {path.relative_to(folder) for path in folder.rglob("*") if "tfevents" not in path.name}
        for folder in (run.folder, twin.folder)
    ]
    assert files[0] == files[1]
    alone = train(tmp_path / "alone", *words.replace("3", "1").split(), "--seed", "2", steps=300)
    assert twin.table(agent=2).drop("agent") == alone.steps.drop("agent")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_the_kinematic_world_is_where_the_robots_think(tmp_path: Path) -> None:
    words = "--world kinematic --agents 3 --device cuda"
    assert train(tmp_path / "a", *words.split(), steps=300).n_decisions == 300


def test_of_many_robots_a_few_are_recorded_and_it_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    words = "--world kinematic --agents 5 --recorded-rows 100 --recorded-agents 2 --steps 260"
    with caplog.at_level(logging.INFO):
        answer = typed("train", "--out", tmp_path / "a", *words.split())
    assert answer.code == 0
    run = load_run(tmp_path / "a")
    assert (run.n_agents, run.n_recorded, run.n_decisions) == (5, 2, 260)
    assert caplog.messages[0] == (
        "Decisions are recorded of the first 2 robots only, window sums of all: 1,300 rows would "
        "be more than recorded_rows (100)"
    )
    said = "Every decision is recorded of the first 2 robots, windows of 250 decisions of all 5."
    assert said in answer.out.splitlines()
    assert (run.folder / "figures" / "zones.png").stat().st_size
    typed("train", "--out", tmp_path / "b", *words.split(), "--recorded-rows", "1300")
    assert load_run(tmp_path / "b").n_recorded == 5


@pytest.mark.parametrize(
    "words",
    [
        f"--agents {10**6}",
        f"--world kinematic --steps {10**12}",
        f"--n-candidates {10**9}",
        f"--meta.hidden {10**12} {10**12}",
        f"--meta.bins {10**12}",
        f"--shadows mlp --experts mlp --experts.hidden {10**9}",
        f"--experts mlp --experts.children fresh --experts.fresh-minibatches {10**12}",
    ],
)
def test_what_is_far_too_large_is_refused_before_it_is_made(tmp_path: Path, words: str) -> None:
    answer = typed("train", "--out", tmp_path / "a", *words.split())
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("torch-iac: a run must fit into memory: ")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("world", ["toyroom", "kinematic"])
def test_a_run_that_will_not_fit_into_memory_is_refused(tmp_path: Path, world: str) -> None:
    answer = typed("train", "--world", world, "--agents", "1000000", "--out", tmp_path / "a")
    assert (answer.code, answer.out) == (2, "")
    assert re.fullmatch(
        r"torch-iac: a run must fit into memory: 1,000,000 (worlds|agents and 10,000 decisions) "
        r"need about [\d.]+ GB on cpu, got [\d.]+ GB free; "
        r"lower agents(, steps or max_examples)?\n",
        answer.err,
    )
    assert not (tmp_path / "a").exists()


def test_figures_are_drawn_anew(tmp_path: Path) -> None:
    folder = train(tmp_path / "a").folder
    for path in (folder / "figures").iterdir():
        path.unlink()
    answer = typed("figures", folder, "--pdf")
    assert (answer.code, answer.err) == (0, "")
    figures = ("experts", "tree", "zones", "calibration")
    names = [f"{figure}.{kind}" for figure in figures for kind in ("png", "pdf")]
    assert answer.out.splitlines() == [str(folder / "figures" / name) for name in names]
    assert all((folder / "figures" / name).stat().st_size for name in names)


def test_a_run_is_exported_for_other_programs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("minari", reason="needs Minari: pip install 'torch_iac[minari]'")
    pytest.importorskip("rerun", reason="needs Rerun: pip install 'torch_iac[rerun]'")
    folder, sets = train(tmp_path / "a").folder, tmp_path / "sets"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(sets))
    file = tmp_path / "a.rrd"
    answer = typed("export", folder, "--rerun", file, "--minari", "room-v0")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.splitlines() == [str(file), str(sets / "room-v0" / "data")]
    assert file.stat().st_size


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "export needs a target: --rerun FILE.rrd, --minari NAME or both"),
        (("--rerun", "a.rrd"), "--rerun needs Rerun: pip install 'torch_iac[rerun]'"),
        (("--minari", "a-v0"), "--minari needs Minari: pip install 'torch_iac[minari]'"),
    ],
    ids=["nothing", "rerun", "minari"],
)
def test_what_an_export_needs_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], sentence: str
) -> None:
    for library in ("rerun", "minari"):
        monkeypatch.setitem(sys.modules, library, None)  # as if it were not installed
    folder = write_run(tmp_path / "a", n_decisions=10)
    answer = typed("export", folder, *words)
    assert (answer.code, answer.out, answer.err) == (2, "", f"torch-iac: {sentence}\n")


def test_a_run_is_filmed_into_its_folder(tmp_path: Path) -> None:
    folder = train(tmp_path / "a").folder
    answer = typed("replay", folder, "--at", "3", "--decisions", "1")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out == f"{folder / 'figures' / 'replay.mp4'}\n"
    title = 15
    assert count_frames_and_secs(folder / "figures" / "replay.mp4") == (title + 5, 2.0)


def test_a_robot_of_a_population_is_filmed_where_asked(tmp_path: Path) -> None:
    run = train(tmp_path / "a", "--world", "kinematic", "--agents", "2", "--world-options=beams=0")
    out = tmp_path / "film.gif"
    answer = typed("replay", run.folder, "--agent", "1", "--decisions", "2", "--out", out)
    assert (answer.code, answer.out, answer.err) == (0, f"{out}\n", "")
    with Image.open(out) as film:
        n_frames = sum(1 for _ in ImageSequence.Iterator(film))
    assert n_frames == 6  # two titles, and two decisions each


def test_a_run_that_cannot_be_filmed_is_refused_with_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = train(tmp_path / "a", "--world", "kinematic").folder
    before = fingerprints(folder)
    for words, sentence in (
        ("--at 5", "decisions must lie in [0, 5), got 5"),
        ("--agent 1", "agent must lie in [0, 1), got 1"),
        ("--out film.avi", "a film must be a .mp4 or a .gif, got film.avi"),
    ):
        answer = typed("replay", folder, *words.split())
        assert (answer.code, answer.out, answer.err) == (2, "", f"torch-iac: {sentence}\n")
    monkeypatch.setitem(ToyRoomKinematic.metadata, "render_modes", [])
    answer = typed("replay", folder)
    assert answer.err == (
        f"torch-iac: the world of {folder} draws no pictures, so it cannot be replayed\n"
    )
    assert fingerprints(folder) == before


# Help.


@pytest.mark.parametrize(
    ("command", "some"),
    [
        ("train", {"--preset", "--epsilon", "--experts.k"}),
        ("figures", {"--pdf"}),
        ("replay", {"--at", "--decisions", "--agent", "--out"}),
        ("compare", {"--variant", "--ray"}),
        ("export", {"--rerun", "--minari", "--agent"}),
    ],
)
def test_help_explains_every_option(command: str, some: set[str]) -> None:
    answer = typed(command, "--help")
    assert (answer.code, answer.err) == (0, "")
    _, _, rest = answer.out.partition("\n\n")
    text = " ".join(line.strip() for line in rest.splitlines())
    options = re.split(r" (?=--[a-z])(?<!, )", text)[1:]
    assert {option.split(" ")[0].rstrip(",") for option in options} >= some
    for option in options:
        assert re.search(r"[A-Z].*[\w)]\.( \(default: [^)]+\))?(\s+[a-z].*:)?$", option), option
    assert not re.search(r"None|\(default: \)", text)


def test_help_shows_the_presets_numbers() -> None:
    text = typed("train", "--preset", "iac2007", "--help").out
    assert re.search(r"--epsilon FLOAT .*\(default: 0\.15\)", text)
    assert re.search(r"--window INT .*\(default: 26\)", text)


def test_help_names_the_commands() -> None:
    answer = typed("--help")
    assert answer.code == 0
    assert "  train    Let robots develop in a world" in answer.out
    assert "  figures  Draw a run into its folder" in answer.out


# Bad input.

BAD_VALUES = [
    ("--epsilon 1.3", "epsilon must lie in [0, 1], got 1.3"),
    ("--balance 0.6", "balance must lie in [0, 0.5], got 0.6"),
    ("--max-examples 1", "max_examples must be at least 2, got 1"),
    ("--experts.k 0", "experts: k must be at least 1, got 0"),
    (
        "--experts mlp --experts.hidden 0",
        "experts: hidden must be at least 1 unit a layer, got (0,)",
    ),
    ("--no-mp --drive global_progress", "meta must be on for the drive GlobalProgress, got None"),
    ("--outcomes toy_smell", f"outcomes must be sensors ({', '.join(SENSORS)}), got toy_smell"),
    ("--world-options beams", "world options must be written name=value, got beams"),
    (
        "--world-options smell=1",
        "options of toyroom must be among render_mode, width, height, beams, toy_direction, "
        "sensor_noise, actuator_noise, f1_end, f2_end, keyframe_every, substeps, got smell",
    ),
    ("--world-options beams=four", "beams must be a whole number, got four"),
    ("--world-options beams=2.5", "beams must be a whole number, got 2.5"),
    ("--world-options beams=true", "beams must be a whole number, got True"),
    ("--world-options sensor_noise=loud", "sensor_noise must be a number, got loud"),
    ("--world-options toy_direction=1", "toy_direction must be true or false, got 1"),
    ("--world-options beams=1000000000", "beams must be at most 10000, got 1000000000"),
    ("--world-options substeps=1000000000", "substeps must be at most 1000, got 1000000000"),
    ("--world-options sensor_noise=1e300", "sensor_noise must be at most 1000.0, got 1e+300"),
    (
        "--world-options render_mode=sketch",
        "render_mode must be one of (None, 'rgb_array', 'rgb_array_list', 'human'), got 'sketch'",
    ),
    ("--world-options render_mode=[1]", "render_mode must be a text or null, got [1]"),
    (f"--world-options beams={'[' * 9999}", f"beams must be a whole number, got {'[' * 80}"),
    (f"--world-options beams={'9' * 5000}", f"beams must be a whole number, got {'9' * 80}"),
    (
        f"--delay {'9' * 400}",
        "delay must be at most 1,000,000,000,000, got a number of 400 digits",
    ),
    (f"--experts.k {10**30}", f"experts: k must be at most 1,000,000,000,000, got {10**30}"),
    (
        "--drive curriculum --drive.stages.1.dimension smell",
        "a stage must be about an action (left_wheel, right_wheel, sound), got smell",
    ),
    ("--world-options beams=-1", "beams must be at least 0 and finite, got -1"),
    ("--world-options sensor_noise=NaN", "world_options.sensor_noise must be finite, got nan"),
    (
        "--world kinematic --world-options device=cpu",
        "options of kinematic must be among render_mode, width, height, beams, toy_direction, "
        "sensor_noise, actuator_noise, f1_end, f2_end, check_actions, got device",
    ),
    ("--world kinematic --world-options beams=2.5", "beams must be a whole number, got 2.5"),
    (
        "--world kinematic --device abacus",
        "device must be one that this machine has, got abacus",
    ),
    ("--experts oracle", "experts must be knn, mlp, hybrid or module:Name, got oracle"),
    (
        "--choice greedi",
        "choice must be greedy, proportional, softmax or module:Name, got greedi; "
        "perhaps you meant greedy",
    ),
    ("--steps 0", "steps must be at least 1, got 0"),
    ("--agents 0", "agents must be at least 1, got 0"),
    ("--agents 1e7", "agents must be at most 1,000,000, got 10,000,000"),
    ("--log-every 0", "log_every must be at least 1, got 0"),
    ("--recorded-agents 0", "recorded_agents must be at least 1, got 0"),
    ("--recorded-rows -1", "recorded_rows must be at least 0, got -1"),
    ("--meta.memory 0", "meta: memory must be at least 1, got 0"),
    ("--seed -1", "seed must lie in [0, 4294967296), got -1"),
    ("--device abacus", "device must be one that this machine has, got abacus"),
    ("--device meta", "device must be one that this machine has, got meta"),
    pytest.param(
        "--device cuda",
        "device must be one that this machine has, got cuda",
        marks=pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU"),
    ),
]

BAD_OPTIONS = [
    ("--preset iac1999", "--preset must be iac2004 or iac2007, got iac1999"),
    ("--preset", "--preset: expected one argument"),
    ("--hunger 3", "Unrecognized options: --hunger, 3"),
    ("--steps ten", "--steps must be a whole number, got ten"),
    ("--steps 1e-1", "--steps must be a whole number, got 1e-1"),
    ("--epsilon many", "--epsilon must be a number, got many"),
    ("--no-mp=3", "--mp/--no-mp: ignored explicit argument '3'"),
]


def refused(words: str, run: Run, tmp_path: Path) -> str:
    """Return what stderr says of bad words, after seeing that they leave nothing behind."""
    before = fingerprints(run.folder)
    for folder in (tmp_path / "new", run.folder):
        answer = typed("train", "--steps", "5", "--out", folder, *words.split())
        assert (answer.code, answer.out) == (2, "")
    assert fingerprints(run.folder) == before
    assert not any(tmp_path.iterdir())
    return answer.err


@pytest.mark.parametrize(("words", "sentence"), BAD_VALUES)
def test_a_bad_value_is_answered_with_one_sentence(
    run: Run, tmp_path: Path, words: str, sentence: str
) -> None:
    assert refused(words, run, tmp_path) == f"torch-iac: {sentence}\n"


@pytest.mark.parametrize(("words", "sentence"), BAD_OPTIONS)
def test_a_bad_option_is_answered_with_a_sentence_and_where_to_find_help(
    run: Run, tmp_path: Path, words: str, sentence: str
) -> None:
    answer = refused(words, run, tmp_path)
    assert sentence in answer
    assert answer.startswith("torch-iac: ")
    assert answer.endswith(" (see torch-iac train --help)\n")
    assert answer.count("\n") == 1


@pytest.mark.parametrize("words", [["trian"], ["--steps", "3"], []])
def test_an_unknown_command_is_answered_with_those_there_are(words: list[str]) -> None:
    answer = typed(*words)
    assert answer.code == 2
    assert re.search(r"train.*figures", answer.err)


def test_a_run_is_never_overwritten(run: Run) -> None:
    before = fingerprints(run.folder)
    answer = typed("train", "--steps", "5", "--out", run.folder)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == (
        f"torch-iac: {run.folder} already holds a run; resume it or choose another folder\n"
    )
    assert fingerprints(run.folder) == before


def test_a_file_is_no_place_for_a_run(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    answer = typed("train", "--steps", "5", "--out", file / "run")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == f"torch-iac: {file}/run cannot be a run folder: {file} is a file\n"
    assert fingerprints(tmp_path) == {"file": hashlib.sha256(b"mine").hexdigest()}


def test_what_the_operating_system_refuses_is_said_without_its_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, **_: Any) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "mkdir", refuse)
    answer = typed("train", "--steps", "5", "--out", tmp_path / "a")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == f"torch-iac: {tmp_path}/a: Permission denied\n"


def test_figures_need_a_run(tmp_path: Path) -> None:
    answer = typed("figures", tmp_path)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == f"torch-iac: {tmp_path} holds no run: there is no config.json in it\n"
    assert not any(tmp_path.iterdir())


def test_an_interrupted_run_keeps_its_decisions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(recorder: Recorder, step: Step, zones: Any) -> None:
        if step.number == 150:
            raise KeyboardInterrupt
        record(recorder, step, zones)

    record = Recorder.record
    monkeypatch.setattr(Recorder, "record", interrupted)
    answer = typed("train", "--steps", "300", "--out", tmp_path / "a")
    assert (answer.code, answer.out) == (130, "")
    assert answer.err == f"torch-iac: interrupted; go on with: torch-iac resume {tmp_path / 'a'}\n"
    assert load_run(tmp_path / "a").n_decisions == 150
    assert not (tmp_path / "a" / "summary.json").exists()


# In a process of its own.


def test_the_installed_command_refuses_too(tmp_path: Path) -> None:
    words = [str(SCRIPT), *f"train --out {tmp_path}/a --world-options smell=1".split()]
    answer = subprocess.run(words, capture_output=True, text=True, timeout=900, check=False)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert answer.stderr.splitlines()[-1].startswith("torch-iac: options of toyroom must be among")
    assert "Traceback" not in answer.stderr
    assert not any(tmp_path.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is a signal only there")
def test_ctrl_c_ends_the_installed_command_in_order(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [SCRIPT, "train", "--steps", "1000000", "--out", tmp_path / "a"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Whoever started the tests may have them ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    first_part = tmp_path / "a" / "steps" / "part-00000.parquet"
    give_up = time.monotonic() + 60
    while not first_part.exists() and process.poll() is None and time.monotonic() < give_up:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=900)
    assert (process.returncode, out) == (130, "")
    sentence = r"torch-iac: stopped after decision \d+; go on with: torch-iac resume (.*)"
    words = re.fullmatch(sentence, err.splitlines()[-1])
    assert words
    assert words[1] == str(tmp_path / "a")
    assert "Traceback" not in err
    assert load_run(tmp_path / "a").n_decisions >= 2000


# An experiment in a file.


def test_a_run_is_made_again_with_changes(tmp_path: Path) -> None:
    words = "--world kinematic --no-mp --max-examples 15 --window 5 --delay 5 --drive error"
    experts = "--experts tests.cli.parts_of_a_user:Wide --experts.width 3"
    first = typed(
        "train", "--out", tmp_path / "a", "--steps", "20", *words.split(), *experts.split()
    )
    assert first.code == 0, first.err
    file = tmp_path / "a" / "config.json"
    again = typed("train", "--config", file, "--out", tmp_path / "b")
    assert again.code == 0, again.err
    assert differences(tmp_path / "b", tmp_path / "a") == []
    changes = ["--experts.width", "4", "--seed", "7", "--steps", "2e1", "--drive", "random"]
    changed = typed("train", "--config", file, "--out", tmp_path / "c", *changes)
    assert changed.code == 0, changed.err
    config = load_run(tmp_path / "c").config
    assert config["seeds"] == [7]
    assert config["iac"]["experts"]["module"]["width"] == 4
    assert config["iac"]["drive"] == {"kind": "Random"}
    assert (config["iac"]["meta"], config["iac"]["max_examples"]) == (None, 15)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("{", "cannot be read"),
        ("[]", "must have fields by name, got []"),
        ('{"stops": 3}', "must have fields among world, iac, seeds, steps"),
        ('{"iac": {"drive": {"kind": "no.such:Drive"}}}', "must be importable, got no.such:Drive"),
        ('{"seeds": [3, 5]}', "must follow each other, got (3, 5)"),
        ('{"world": "Mars-v0"}', "Mars"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, content: str, sentence: str) -> None:
    file = tmp_path / "experiment.json"
    file.write_text(content)
    answer = typed("train", "--config", file, "--out", tmp_path / "a")
    assert (answer.code, answer.out) == (2, "")
    assert sentence in answer.err
    assert answer.err.count("\n") == 1
    assert not (tmp_path / "a").exists()


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    answer = typed("train", "--config", tmp_path / "none.json")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == f"torch-iac: {tmp_path}/none.json: No such file or directory\n"
