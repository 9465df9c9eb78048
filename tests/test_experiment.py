"""An experiment: JSON and back, and runs made from Python."""

import json
from dataclasses import fields
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Any, Self

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

import torch_iac as iac
from tests.same_run import differences
from torch_iac import experiment as experiment_module
from torch_iac.experiment import Experiment, StoppedError
from torch_iac.kinds import CHOICES, DRIVES, EXPERTS

SMALL = iac.IACConfig(
    n_candidates=5, max_examples=15, window=5, delay=5, meta=None, experts=iac.MLPExperts()
)


class Linear(nn.Linear):
    """A network whose class is its factory."""


counts = st.integers(1, 10**12)
configs = st.builds(
    iac.IACConfig,
    experts=st.sampled_from(
        [
            *(kind() for kind in EXPERTS.values()),
            iac.NetworkExperts(module=Linear),
            iac.NetworkExperts(module=iac.MLP((3, 4))),
        ]
    ),
    drive=st.sampled_from([kind() for name, kind in DRIVES.items() if name != "improvement"]),
    choice=st.sampled_from([kind() for kind in CHOICES.values()]),
    meta=st.builds(iac.MetaPredictor, bins=st.integers(1, 50), learning_rate=st.floats(1e-9, 1)),
    shadows=st.dictionaries(st.text("abc", min_size=1), st.just(iac.KNNExperts(k=3)), max_size=2),
    n_candidates=counts,
    epsilon=st.floats(0, 1),
    balance=st.floats(0, 0.5),
    error=st.sampled_from(["absolute", "squared"]),
    inherit_history=st.booleans(),
)
experiments = st.builds(
    Experiment,
    world=st.text(min_size=1),
    config=configs,
    seeds=st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=4),
    steps=counts,
    outcomes=st.lists(st.text()),
    world_options=st.dictionaries(
        st.text(),
        st.none() | st.booleans() | st.integers() | st.floats(-9, 9) | st.lists(st.text()),
    ),
    hold=st.integers(1, 1000),
    sensor_bounds=st.dictionaries(st.text(), st.tuples(st.floats(-9, 0), st.floats(1, 9))),
    recorded_rows=st.integers(0, 10**12),
)


@settings(max_examples=50, deadline=None)
@given(experiments)
def test_json_and_back(experiment: Experiment) -> None:
    content = json.loads(json.dumps(experiment.to_json()))
    again = Experiment.from_json(content)
    assert again == experiment
    assert again.to_json() == experiment.to_json()


def test_what_is_missing_has_its_default() -> None:
    assert Experiment.from_json({}) == Experiment()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ([], r"an experiment must have fields by name, got \[\]"),
        ({"stops": 3}, "experiment must have fields among .*, got stops"),
        ({"steps": "many"}, "experiment.steps must be of its type, got 'many'"),
        ({"steps": 0}, "steps must be at least 1, got 0"),
        ({"seeds": [-1]}, r"seed must lie in \[0, 4294967296\), got -1"),
        ({"iac": {"epsilon": 2}}, r"epsilon must lie in \[0, 1\], got 2"),
        ({"iac": {"epsilom": 2}}, "iac must have fields among .*, got epsilom"),
        ({"iac": {"drive": {"kind": "Hunger"}}}, "iac.drive must be of a known kind"),
        ({"iac": {"drive": {"kind": "KNNExperts"}}}, "iac.drive must be of its type"),
        ({"sensor_bounds": {"a": [1]}}, "experiment.sensor_bounds must be of its type"),
    ],
)
def test_the_file_is_checked_strictly(content: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Experiment.from_json(content)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"seeds": 0}, "seeds must be a list, got 0"),
        ({"seeds": []}, "seeds must name at least one robot, got none"),
        ({"seeds": range(10**9)}, "seeds must be at most 1,000,000, got 1,000,000,000"),
        ({"outcomes": "toy_distance"}, "outcomes must be a list, got 'toy_distance'"),
        ({"seeds": [0, 1.5]}, r"seeds.1 must be a whole number, got 1.5"),
        ({"seeds": [True]}, r"seeds.0 must be a whole number, got True"),
        ({"outcomes": [3]}, r"outcomes.0 must be a text, got 3"),
        ({"world_options": {"f": print}}, r"world_options.f must be a number, a text"),
        ({"world_options": {"f": float("nan")}}, r"world_options.f must be finite, got nan"),
        ({"sensor_bounds": {"x": (0, "1")}}, r"sensor_bounds.x.1 must be a number, got '1'"),
        ({"sensor_bounds": {"x": (0, float("inf"))}}, "the bounds of x must be finite"),
        ({"config": {}}, r"config must be of the kind IACConfig, got \{\}"),
        ({"hold": 0}, r"hold must lie in \[1, 1,000\], got 0"),
        (
            {"config": iac.IACConfig(experts=iac.NetworkExperts(module=lambda n, m: Linear(n, m)))},
            "define it outside of any function",
        ),
    ],
)
def test_what_cannot_be_is_refused(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Experiment(**values)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> iac.Run:
    """A run made from Python."""
    experiment = Experiment(world="kinematic", config=SMALL, seeds=[3, 4], steps=60)
    return experiment.run(tmp_path_factory.mktemp("run") / "whole")


def test_a_run_is_whole(run: iac.Run) -> None:
    assert (run.n_agents, run.n_decisions) == (2, 60)
    assert run.seeds == (3, 4)
    assert run.summary["n_regions"] > 1
    assert (run.folder / "figures").is_dir()
    assert "command" not in run.config


def test_a_run_says_what_is_needed_to_make_it_again(run: iac.Run, tmp_path: Path) -> None:
    experiment = iac.load_experiment(run.folder)
    assert experiment == Experiment(world="kinematic", config=SMALL, seeds=(3, 4), steps=60)
    assert iac.load_experiment(run.folder / "config.json") == experiment
    assert differences(experiment.run(tmp_path / "again").folder, run.folder) == []


def test_a_run_that_is_stopped_goes_on(run: iac.Run, tmp_path: Path) -> None:
    asked = iter([False] * 30 + [True])
    with pytest.raises(StoppedError, match="stopped after decision 31; go on with") as stopped:
        iac.load_experiment(run.folder).run(tmp_path / "a", stop=lambda: next(asked))
    assert stopped.value.n_decisions == 31
    assert differences(iac.resume(tmp_path / "a").folder, run.folder) == []


def test_a_run_can_become_longer(tmp_path: Path) -> None:
    short = Experiment(world="kinematic", config=SMALL, steps=20)
    long = Experiment(world="kinematic", config=SMALL, steps=30)
    short.run(tmp_path / "a")
    with pytest.raises(ValueError, match=r"steps must be above the 20 that .* has ended with"):
        iac.resume(tmp_path / "a")
    iac.resume(tmp_path / "a", 30)
    assert differences(tmp_path / "a", long.run(tmp_path / "b").folder) == []
    assert long.run_or_resume(tmp_path / "a").n_decisions == 30


def test_robots_are_loaded_as_they_were(run: iac.Run) -> None:
    agent = iac.load_agent(run.folder)
    assert agent.n_decisions == 60
    assert repr(agent).startswith("IAC(MLPExperts, Progress: 2 agents, 60 decisions, ")
    summary = agent.region_summary()
    assert len(summary.region) == agent.tree.n_rows
    with pytest.raises(FileNotFoundError, match="61"):
        iac.load_agent(run.folder, 61)


def test_a_regions_network_is_a_module_of_its_own(run: iac.Run) -> None:
    agent = iac.load_agent(run.folder)
    summary = agent.region_summary()
    region = int(summary.region[summary.agent == 1][0])
    network = agent.expert(region, agent=1)
    situation = torch.rand(1, len(agent.space.situation))
    (node,) = agent.tree.leaves()[
        (agent.tree.region[agent.tree.leaves()] == region)
        & (agent.tree.agent[agent.tree.leaves()] == 1)
    ]
    row = agent.tree.rows[node][None]
    expected = agent.experts.predict(agent.examples, row, situation)
    torch.testing.assert_close(network(situation), expected, rtol=1e-5, atol=1e-6)
    loss = network(situation).sum()
    loss.backward()
    assert all(weights.grad is not None for weights in network.parameters())


def test_of_nearest_neighbours_the_examples_are_given(tmp_path: Path) -> None:
    config = iac.IACConfig(meta=None)
    Experiment(world="kinematic", config=config, steps=20).run(tmp_path / "a")
    agent = iac.load_agent(tmp_path / "a")
    held = agent.expert(0)
    assert held.situations.shape == (20, len(agent.space.situation))
    assert held.outcomes.shape == (20, 1)
    for wrong, sentence in (((9,), "region must be a leaf of agent 0"), ((0, 1), "agent must lie")):
        with pytest.raises(ValueError, match=sentence):
            agent.expert(*wrong)


class Touchy(gym.Env[Any, Any]):
    """A world that can be made with any size, and reset with few."""

    action_space = observation_space = gym.spaces.Box(0.0, 1.0, (1,), np.float32)

    def __init__(self, size: int = 0) -> None:
        self._size = size

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return np.full(1, 0.5 / self._size, np.float32), {}


def test_an_option_on_which_a_world_breaks_when_it_is_reset_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gym.envs.registration, "registry", {})
    gym.register("Touchy-v0", entry_point=Touchy)  # type: ignore[arg-type]
    for begin in (Experiment.check, Experiment.run):
        with pytest.raises(ValueError, match=r"^Touchy-v0 cannot be reset with size=0: ZeroDiv"):
            begin(Experiment(world="Touchy-v0", world_options={"size": 0}))
        with pytest.raises(ZeroDivisionError):  # perhaps a bug of the world
            begin(Experiment(world="Touchy-v0"))
    Experiment(world="Touchy-v0", world_options={"size": 1}).check()
    assert not list(tmp_path.iterdir())


def test_runs_that_begin_in_the_same_second_have_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Self:
            return cls(2030, 1, 2, 3, 4, 5, tzinfo=tz)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(experiment_module, "datetime", Stopped)
    folders = [experiment_module._new_folder("a:b/c") for _ in range(3)]
    name = "20300102-030405-a-b-c"
    assert [folder.name for folder in folders] == [name, f"{name}-2", f"{name}-3"]
    assert all(folder.is_dir() for folder in folders)


def test_a_run_of_a_loop_of_ones_own_is_no_experiment(tmp_path: Path) -> None:
    from tests.synthetic_run import write_run

    write_run(tmp_path / "a")
    with pytest.raises(ValueError, match="must be the run of an experiment"):
        iac.resume(tmp_path / "a")


def test_equal_experiments_have_equal_hashes() -> None:
    one = Experiment(world_options={"a": [1], "b": 2}, sensor_bounds={"x": (0, 1)}, seeds=range(2))
    other = Experiment(
        world_options={"b": 2, "a": (1,)}, sensor_bounds={"x": (0.0, 1.0)}, seeds=[0, 1]
    )
    assert one == other
    assert hash(one) == hash(other)
    assert one.to_json() == other.to_json()


def test_every_field_says_what_it_is() -> None:
    names = {field.name for field in fields(Experiment)}
    assert names >= {"world", "config", "seeds", "steps", "device", "outcomes"}
