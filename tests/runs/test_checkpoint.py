"""A checkpoint brings everything back or says why not, whatever happened to its files."""

import json
import os
import pickle
import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import save

import torch_iac_envs  # noqa: F401 - registers the worlds
from tests.internal.test_state import assert_equal
from torch_iac import IAC, IACConfig, MetaPredictor, MLPExperts, SensorimotorSpace
from torch_iac.internal.files import dump_json
from torch_iac.runs import checkpoint
from torch_iac.runs.checkpoint import Checkpoint, Checkpoints, identity

IDENTITY = {"config": {"epsilon": 0.1, "shadows": {}}, "seeds": [0, 1], "world": None}
FILES = ["LATEST", "*/manifest.json", "*/state.json", "*/state.safetensors"]


def saved(number: int) -> Checkpoint:
    """A small checkpoint, that of a decision."""
    agent = {"tree/parent": torch.arange(number), "n_decisions": torch.tensor(number)}
    return Checkpoint(number, agent, {"robot": np.full(3, number)}, {"parts": number})


def checkpoints(folder: Path, **changes: Any) -> Checkpoints:
    return Checkpoints(folder, {**IDENTITY, **changes})


def two(folder: Path) -> Checkpoints:
    """The checkpoints of decisions 10 and 20."""
    writer = checkpoints(folder)
    writer.write(saved(10))
    writer.write(saved(20))
    return writer


def file_of(folder: Path, pattern: str, number: int = 20) -> Path:
    return folder / pattern.replace("*", f"{number:012d}")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def reads(folder: Path, number: int) -> None:
    """Check that the checkpoint of a decision comes back whole."""
    found = checkpoints(folder).read()
    assert found.n_decisions == found.loop["parts"] == number
    assert found.world["robot"].tolist() == [number] * 3
    assert found.agent.keys() == {"tree/parent", "n_decisions"}
    assert torch.equal(found.agent["tree/parent"], torch.arange(number))


CONFIG = IACConfig(
    n_candidates=5,
    max_examples=20,
    window=8,
    delay=8,
    experts=MLPExperts(hidden=(8,), minibatches=1),
    shadows={"fresh": MLPExperts(hidden=(8,), minibatches=1, children="fresh")},
    meta=MetaPredictor(minibatches=1),
)

World = gym.vector.VectorEnv[Any, Any, Any]


def toy_room() -> World:
    return gym.make_vec("torch_iac_envs/ToyRoom-v0", num_envs=2, vectorization_mode="sync")


def kinematic() -> World:
    return gym.make_vec("torch_iac_envs/ToyRoomKinematic-v0", num_envs=2)


def get_state(env: Any) -> Any:
    return env.call("get_state") if hasattr(env, "envs") else env.unwrapped.get_state()


def set_state(env: Any, state: Any) -> None:
    if not hasattr(env, "envs"):
        env.unwrapped.set_state(state)
    for world, of_one in zip(getattr(env, "envs", ()), state, strict=False):
        world.unwrapped.set_state(of_one)


@pytest.mark.parametrize(("make", "stop"), [(toy_room, 117), (kinematic, 30)])
def test_agents_and_world_go_on_bit_for_bit(
    make: Callable[[], World], stop: int, tmp_path: Path
) -> None:
    env = make()
    space = SensorimotorSpace.from_env(env, ["toy_distance"])
    agent = IAC(space, CONFIG, [4, 5])
    sensors, _ = env.reset(seed=[4, 5])  # type: ignore[arg-type]  # a list is fine
    steps = []
    for number in range(stop + 25):
        if number == stop:
            now = Checkpoint(number, agent.state(), get_state(env), {"sensors": sensors})
            Checkpoints(tmp_path, identity(agent)).write(now)
        sensors, *_ = env.step(agent.act(sensors))
        steps.append(agent.observe(sensors))
    env.close()

    again, resumed = make(), IAC(space, CONFIG, [4, 5])
    again.reset()
    found = Checkpoints(tmp_path, identity(resumed)).read()
    resumed.load_state(found.agent)
    set_state(again, found.world)
    sensors = found.loop["sensors"]
    for step in steps[found.n_decisions :]:
        sensors, *_ = again.step(resumed.act(sensors))
        assert_equal(resumed.observe(sensors), step)
    again.close()
    assert step.regions.max() > 0


def test_the_last_two_are_kept(tmp_path: Path) -> None:
    writer = checkpoints(tmp_path / "run" / "checkpoints")
    for number in (0, 5, 10, 15, 20):
        writer.write(saved(number))
        reads(writer.folder, number)
    assert names(writer.folder) == ["000000000015", "000000000020", "LATEST"]
    files = ["manifest.json", "state.json", "state.safetensors"]
    assert names(writer.folder / "000000000020") == files


def test_nothing_sound_is_written_over_and_what_is_damaged_goes(tmp_path: Path) -> None:
    two(tmp_path)
    file_of(tmp_path, "*/state.json").write_bytes(b"")
    reader = checkpoints(tmp_path)
    with pytest.warns(UserWarning, match="state.json"):
        assert reader.read().n_decisions == 10
    assert reader.write(saved(20)).name == "000000000020-1"
    assert names(tmp_path) == ["000000000010", "000000000020-1", "LATEST"]
    reads(tmp_path, 20)
    assert reader.write(saved(20)).name == "000000000020"
    reads(tmp_path, 20)


def test_where_there_is_none_it_says_so(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(FileNotFoundError, match="holds no checkpoint"):
            checkpoints(folder).read()


def damaged(folder: Path, path: Path, data: bytes) -> None:
    """Check that a file with other content is noticed, and that nothing is lost."""
    path.write_bytes(data)
    expected = 20 if path.name == "LATEST" else 10
    with pytest.warns(UserWarning, match=f"is damaged, going on from 0+{expected}: .*{path.name}"):
        reads(folder, expected)


@pytest.fixture(scope="module")
def two_checkpoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    two(folder)
    return folder


@pytest.mark.parametrize("pattern", FILES)
@given(data=st.data())
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_other_byte_is_noticed(
    pattern: str, data: st.DataObject, two_checkpoints: Path
) -> None:
    path = file_of(two_checkpoints, pattern)
    whole = path.read_bytes()
    place = data.draw(st.integers(0, len(whole) - 1))
    flip = data.draw(
        st.one_of(st.sampled_from([1 << bit for bit in range(8)]), st.integers(1, 255))
    )
    try:
        other = bytearray(whole)
        other[place] ^= flip
        damaged(two_checkpoints, path, bytes(other))
    finally:
        path.write_bytes(whole)


@pytest.mark.parametrize("pattern", FILES)
@pytest.mark.parametrize("kept", [0, 1, 0.5, -1])
def test_a_truncated_file_is_noticed(pattern: str, kept: float, tmp_path: Path) -> None:
    two(tmp_path)
    path = file_of(tmp_path, pattern)
    whole = path.read_bytes()
    damaged(tmp_path, path, whole[: int(len(whole) * kept) if kept == 0.5 else int(kept)])


@pytest.mark.parametrize("pattern", FILES[1:])
def test_a_file_that_is_missing_is_noticed(pattern: str, tmp_path: Path) -> None:
    two(tmp_path)
    file_of(tmp_path, pattern).unlink()
    with pytest.warns(UserWarning, match=f"{Path(pattern).name} must be a file, got none"):
        reads(tmp_path, 10)


@pytest.mark.parametrize("pattern", FILES[1:])
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(pattern: str, tmp_path: Path) -> None:
    two(tmp_path)
    file_of(tmp_path, pattern).unlink()
    os.mkfifo(file_of(tmp_path, pattern))
    with pytest.warns(UserWarning, match="must be a file"):
        reads(tmp_path, 10)


def test_without_latest_the_newest_is_taken(tmp_path: Path) -> None:
    two(tmp_path)
    (tmp_path / "LATEST").unlink()
    reads(tmp_path, 20)


def test_if_none_is_sound_one_sentence_says_so(tmp_path: Path) -> None:
    two(tmp_path)
    for number in (10, 20):
        file_of(tmp_path, "*/state.json", number).write_bytes(b"{}")
    rule = (
        "holds no sound checkpoint: 000000000020/state.json must be as it was written, "
        "got other bytes; 000000000010/state.json"
    )
    with pytest.raises(ValueError, match=rule):
        checkpoints(tmp_path).read()


class Hostile:
    """Makes a folder when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.trace),)


def replace_file(folder: Path, name: str, data: bytes) -> None:
    """Put a file in the place of another, with a manifest that vouches for it."""
    (folder / name).write_bytes(data)
    manifest = json.loads((folder / "manifest.json").read_text())
    digest = sha256(data).hexdigest()
    manifest["files"][name] = {"size": len(data), "sha256": digest}
    (folder / "manifest.json").write_bytes(checkpoint._sealed(manifest))


@pytest.mark.parametrize("name", ["state.safetensors", "state.json"])
@pytest.mark.parametrize("torch_file", [False, True])
def test_a_pickle_is_never_unpickled(name: str, torch_file: bool, tmp_path: Path) -> None:
    folder = checkpoints(tmp_path / "runs").write(saved(1))
    trace, pickled = tmp_path / "was-here", tmp_path / "pickle"
    with pickled.open("wb") as file:
        torch.save(Hostile(trace), file) if torch_file else pickle.dump(Hostile(trace), file)
    pickle.loads(pickle.dumps(Hostile(trace)))
    trace.rmdir()  # so it works, where it is let
    replace_file(folder, name, pickled.read_bytes())
    with pytest.raises(ValueError, match=f"holds no sound checkpoint: .*{name}"):
        checkpoints(tmp_path / "runs").read()
    assert not trace.exists()


def agents(content: str) -> bytes:
    return f'{{"dict": {{"agent": {content}, "world": null, "loop": null}}}}'.encode()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"[" * 100_000, "JSON must be nested at most 100 deep, got more"),
        (b'{"agent": ' + b"[" * 200 + b"]" * 200 + b"}", "nested at most 100 deep"),
        (agents("NaN"), "a number must be finite, got NaN"),
        (agents("-Infinity"), "a number must be finite, got -Infinity"),
        (agents("1e999"), "a number must be finite, got 1e999"),
        (agents("9" * 5000), "JSON must be whole and strict"),
        (agents('{"dict": {"a": 1, "a": 2}}'), "a name must stand once, got 'a' again"),
        (agents("{"), "JSON must be whole and strict"),
        (b"\xff\xfe", "JSON must be whole and strict"),
        (b"[]", "a state must be made of known kinds"),
        (b"{}", "a state must be made of known kinds"),
        (b'{"dict": {}}', "state.json must hold agent, world, loop, got something else"),
        (agents("[1]"), "a state must be made of known kinds"),
        (agents('{"tensor": "elsewhere"}'), "a state must be made of known kinds"),
        (agents('{"tensor": [1]}'), "a state must be made of known kinds"),
        (agents('{"eval": "exit()"}'), "a state must be made of known kinds"),
        (
            agents('{"dict": {"a": {"array": "agent/tree/parent"}}}'),
            "must name the agents' tensors",
        ),
        (agents("1"), "must name the agents' tensors"),
    ],
    ids=lambda value: str(value[:24]),
)
def test_hostile_json_ends_in_one_sentence(data: bytes, message: str, tmp_path: Path) -> None:
    replace_file(checkpoints(tmp_path).write(saved(3)), "state.json", data)
    with pytest.raises(ValueError, match=f"holds no sound checkpoint: .*{message}") as caught:
        checkpoints(tmp_path).read()
    assert "\n" not in str(caught.value)


@given(data=st.binary(max_size=100))
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_no_bytes_vouched_for_do_more_than_be_refused(data: bytes, tmp_path: Path) -> None:
    whole = save({"a": torch.ones(2)})
    for name, content in (
        ("state.safetensors", data),
        ("state.safetensors", whole[:20] + data + whole[20:]),
        ("state.json", data),
        ("manifest.json", data),
    ):
        shutil.rmtree(tmp_path)
        folder = checkpoints(tmp_path).write(saved(3))
        if name == "manifest.json":
            (folder / name).write_bytes(data)
        else:
            replace_file(folder, name, content)
        with pytest.raises(ValueError, match="holds no sound checkpoint"):
            checkpoints(tmp_path).read()


@pytest.mark.parametrize(
    "changes",
    [
        {"files": {}},
        {"files": {"state.json": 1, "state.safetensors": 2}},
        {"files": {"../../secret": {"size": 1, "sha256": ""}}},
        {"n_decisions": "10"},
        {"n_decisions": True},
        {"identity": []},
        {"torch": None},
        {"more": 1},
    ],
)
def test_a_manifest_that_is_whole_but_says_something_else(
    changes: dict[str, Any], tmp_path: Path
) -> None:
    path = checkpoints(tmp_path).write(saved(3)) / "manifest.json"
    path.write_bytes(checkpoint._sealed({**json.loads(path.read_bytes()), **changes}))
    with pytest.raises(ValueError, match=r"holds no sound checkpoint: .*manifest.json must name"):
        checkpoints(tmp_path).read()


def test_links_are_not_followed(tmp_path: Path) -> None:
    elsewhere = checkpoints(tmp_path / "elsewhere").write(saved(30))
    two(tmp_path / "run")
    link = tmp_path / "run" / "000000000030"
    link.symlink_to(elsewhere)
    writer = checkpoints(tmp_path / "run")
    assert writer.read().n_decisions == 20
    writer.write(saved(40))
    assert link.is_symlink()
    reads(tmp_path / "elsewhere", 30)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"config": {"epsilon": 0.2, "shadows": {}}},
            "config.epsilon must be 0.1 as in .*, got 0.2",
        ),
        ({"config": {"shadows": {}}}, "config.epsilon must be 0.1 as in the .*, got nothing"),
        ({"config": {"shadows": {}, "epsilon": 0.1}}, "shadows must not come before config.eps"),
        ({"seeds": [0, 2]}, r"seeds.1 must be 1 as in the checkpoint .*000000000020, got 2"),
        ({"seeds": [0, True]}, r"seeds.1 must be 1 as in the checkpoint .*, got True"),
        ({"seeds": [0]}, r"seeds.1 must be 1 as in the checkpoint .*, got nothing"),
        ({"seeds": [0, 1, 2]}, r"seeds.2 must be nothing as in the checkpoint .*, got 2"),
        ({"world": {"beams": 8}}, "world must be None as in the checkpoint .*, got nothing"),
        ({"torch_iac": "9"}, "torch_iac must be nothing as in the checkpoint .*, got 9"),
    ],
)
def test_another_runs_checkpoint_is_refused(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    two(tmp_path)
    with pytest.raises(ValueError, match=message):
        checkpoints(tmp_path, **changes).read()


def test_what_makes_a_run_is_its_version_space_config_and_seeds(
    space: SensorimotorSpace, tmp_path: Path
) -> None:
    agent = IAC(space, CONFIG, [3])
    Checkpoints(tmp_path, identity(agent, world="a")).write(Checkpoint(0, agent.state()))
    turned = SensorimotorSpace(space.actions[::-1], space.sensors, space.outcomes)
    for other, message in (
        (IAC(space, replace(CONFIG, max_examples=30), [3]), "config.max_examples must be 20 .* 30"),
        (IAC(space, CONFIG, [4]), "seeds.0 must be 3 as in .*, got 4"),
        (IAC(turned, CONFIG, [3]), "space.actions.tone.0 must not come before space.actions.push"),
    ):
        with pytest.raises(ValueError, match=message):
            Checkpoints(tmp_path, identity(other, world="a")).read()
    with pytest.raises(ValueError, match=r"world must be a as in .*, got b"):
        Checkpoints(tmp_path, identity(agent, world="b")).read()
    assert Checkpoints(tmp_path, identity(agent, world="a")).read().n_decisions == 0


def test_another_format_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    two(tmp_path)
    monkeypatch.setattr(checkpoint, "FORMAT", 3)
    with pytest.raises(ValueError, match=r"format must be 3 for this version to read .*, got 2"):
        checkpoints(tmp_path).read()


def test_another_torch_is_warned_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    two(tmp_path)
    monkeypatch.setattr(torch, "__version__", "99")
    with pytest.warns(UserWarning, match="with 99 the last digits may differ"):
        reads(tmp_path, 20)


class KilledError(BaseException):
    """The process ends here."""


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_kill_between_any_two_file_operations_loses_nothing(
    when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = 0
    fatal = -1

    def mortal(operation: Callable[..., Any]) -> Callable[..., Any]:
        def operate(*args: Any, **kwargs: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == fatal and when == "before":
                raise KilledError
            result = operation(*args, **kwargs)
            if calls == fatal:
                raise KilledError
            return result

        return operate

    for name in ("replace", "rename", "fsync", "mkdir", "unlink", "rmdir", "open"):
        monkeypatch.setattr(os, name, mortal(getattr(os, name)))
    monkeypatch.setattr(Path, "write_bytes", mortal(Path.write_bytes))

    outcomes = []
    for moment in range(1, 1000):
        folder = tmp_path / str(moment)
        fatal = -1
        writer = two(folder)
        calls, fatal = 0, moment
        try:
            writer.write(saved(30))
        except KilledError:
            fatal = -1
        else:
            break
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            outcomes.append(checkpoints(folder).read().n_decisions)
        reads(folder, outcomes[-1])
        survivor = checkpoints(folder)
        survivor.read()
        survivor.write(saved(40))
        reads(folder, 40)
        assert len(names(folder)) == 3
    assert outcomes == sorted(outcomes)
    assert {20, 30} == set(outcomes)
    assert len(outcomes) > 15


def test_a_kill_during_the_first_leaves_none_or_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(source: Path, target: Path) -> None:
        del source, target
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", killed)
        with pytest.raises(KilledError):
            checkpoints(tmp_path).write(saved(1))
    with pytest.raises(FileNotFoundError, match="holds no checkpoint"):
        checkpoints(tmp_path).read()
    checkpoints(tmp_path).write(saved(2))
    reads(tmp_path, 2)
    assert names(tmp_path) == ["000000000002", "LATEST"]


def test_a_full_disk_costs_no_checkpoint_and_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = two(tmp_path)

    def full(descriptor: int) -> None:
        del descriptor
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            writer.write(saved(30))
    assert names(tmp_path) == ["000000000010", "000000000020", "LATEST"]
    reads(tmp_path, 20)
    writer.write(saved(30))
    reads(tmp_path, 30)


def test_what_cannot_be_written_as_json_is_refused_before_anything_is_touched(
    tmp_path: Path,
) -> None:
    writer = two(tmp_path)
    with pytest.raises(TypeError, match="world/clock must be made of numbers to be saved, got a o"):
        writer.write(replace(saved(30), world={"clock": object()}))
    with pytest.raises(ValueError, match="not JSON compliant: inf"):
        Checkpoints(tmp_path, {"x": float("inf")})
    reads(tmp_path, 20)
    assert dump_json({"a": 1}) == b'{\n  "a": 1\n}\n'
