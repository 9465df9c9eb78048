"""The ends of episodes in worlds that reset themselves: a step's outcome and zone are its own."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import torch_iac as iac
from torch_iac import IAC, IACConfig, SensorimotorSpace, VectorProgressReward
from torch_iac.runs.reader import load_run
from torch_iac.runs.recorder import Recorder
from torch_iac.training import train
from torch_iac.worlds.make import make_world
from torch_iac.worlds.vector import CopiedSensors, World, outcome_of, zones_of

CONFIG = IACConfig(n_candidates=5, max_examples=20, window=8, delay=8)
SAME_STEP = AutoresetMode.SAME_STEP

Sensors = NDArray[Any]


class Steps(gym.Env[Sensors, Sensors]):
    """Its sensor counts the steps of an episode, and its zone is 1 if the count is odd.

    Args:
        length: How long an episode is.
        reuses: Whether it has one array for all that it shows.
        tells: Whether a reset tells of a zone: 0, where the count begins.
    """

    metadata: dict[str, Any] = {"zone_names": ("even", "odd")}  # noqa: RUF012 - gymnasium's type

    def __init__(self, length: int = 3, reuses: bool = False, tells: bool = True) -> None:
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gym.spaces.Box(0.0, 10.0, (1,), np.float32)
        self._length, self._reuses, self._tells = length, reuses, tells
        self._shown = np.zeros(1, np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Sensors, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self._count = 0
        return self._sense(), {"zone": 0} if self._tells else {}

    def step(self, _: Sensors) -> tuple[Sensors, SupportsFloat, bool, bool, dict[str, Any]]:
        self._count += 1
        is_over = self._count == self._length
        return self._sense(), 0.0, is_over, False, {"zone": self._count % 2}

    def _sense(self) -> Sensors:
        if not self._reuses:
            self._shown = self._shown.copy()
        self._shown[:] = self._count
        return self._shown


def reused() -> gym.Env[Sensors, Sensors]:
    return Steps(reuses=True)


def copied() -> gym.Env[Sensors, Sensors]:
    return CopiedSensors(reused())


def lived(folder: Path, env: World, n_decisions: int = 8) -> tuple[list[Any], list[Any]]:
    """Return the outcomes and the zones of a run, each of shape `(A, T)`."""
    agent = IAC(SensorimotorSpace.from_env(env), CONFIG, range(env.num_envs))
    with Recorder(folder, agent, env.metadata.get("zone_names")) as recorder:
        train(agent, env, n_decisions, recorder)
    env.close()
    run = load_run(folder)
    return run.column("outcome/sensor_0").T.tolist(), run.column("zone").T.tolist()


vectors = pytest.mark.parametrize("vector", [SyncVectorEnv, AsyncVectorEnv])


# Zones.


@vectors
@pytest.mark.parametrize("tells", [True, False])
def test_outcomes_and_zones_are_those_of_the_step(tmp_path: Path, vector: Any, tells: bool) -> None:
    env = vector(
        [lambda: Steps(3, tells=tells), lambda: Steps(5, tells=tells)], autoreset_mode=SAME_STEP
    )
    outcomes, zones = lived(tmp_path, env)
    assert outcomes == [[1, 2, 3, 1, 2, 3, 1, 2], [1, 2, 3, 4, 5, 1, 2, 3]]
    assert zones == [[1, 0, 1, 1, 0, 1, 1, 0], [1, 0, 1, 0, 1, 1, 0, 1]]


@pytest.mark.filterwarnings("ignore:.*share an object")  # Gymnasium warns of it too
@pytest.mark.parametrize("tells", [True, False])
@pytest.mark.parametrize("reuses", [True, False])
def test_so_they_are_in_a_world_made_by_its_name(tmp_path: Path, tells: bool, reuses: bool) -> None:
    maker: Any = Steps
    gym.register("Steps-v0", maker, max_episode_steps=4, kwargs={"length": 9})
    try:
        env = make_world("Steps-v0", 2, {"tells": tells, "reuses": reuses}, torch.device("cpu"))
    finally:
        del gym.registry["Steps-v0"]
    outcomes, zones = lived(tmp_path, env, 10)
    assert outcomes == [[1, 2, 3, 4, 1, 2, 3, 4, 1, 2]] * 2
    assert zones == [[1, 0, 1, 0, 1, 0, 1, 0, 1, 0]] * 2


FORMS: dict[str, Callable[[list[int | None]], Any]] = {
    "columns": lambda zones: {
        "zone": np.array([zone or 0 for zone in zones]),
        "_zone": np.array([zone is not None for zone in zones]),
    },
    "tensors": lambda zones: {
        "zone": torch.tensor([zone or 0 for zone in zones]),
        "_zone": torch.tensor([zone is not None for zone in zones]),
    },
    "objects": lambda zones: np.array(
        [None if zone is None else {"zone": zone} for zone in zones] + [0], dtype=object
    )[:-1],
    "list": lambda zones: [{} if zone is None else {"zone": torch.tensor(zone)} for zone in zones],
}

of_worlds = st.lists(
    st.tuples(st.booleans(), st.integers(1, 3), st.none() | st.integers(1, 3)),
    min_size=1,
    max_size=5,
)


@pytest.mark.parametrize("is_tensor", [False, True])
@pytest.mark.parametrize("form", FORMS)
@given(worlds=of_worlds)
def test_a_zone_is_taken_from_where_the_step_tells_of_it(
    form: str, is_tensor: bool, worlds: list[tuple[bool, int, int | None]]
) -> None:
    """Of each world: whether an episode ended, its own zone, and that of a reset, if it tells."""
    ends = np.array([is_over for is_over, *_ in worlds])
    shown = [at_reset if is_over else own for is_over, own, at_reset in worlds]
    last = [own if is_over else None for is_over, own, _ in worlds]
    info = dict(FORMS["tensors" if is_tensor else "columns"](shown))
    if not any(zone is not None for zone in shown):
        info = {}
    if ends.any():
        info["final_info"] = FORMS[form](last)
    zones = zones_of(torch.tensor(ends) if is_tensor else ends, info)
    assert zones is not None
    assert zones.tolist() == [own for _, own, _ in worlds]


@pytest.mark.parametrize(
    "info",
    [
        {"zone": np.array([1, 0]), "_zone": np.array([True, False])},
        {"zone": np.array([1, 0]), "final_info": {"steps": np.array([0, 3])}},
        {"zone": np.array([1, 0]), "final_info": [None, {}]},
        {"zone": torch.tensor([1, 0]), "_zone": torch.tensor([True, False])},
    ],
)
def test_a_world_that_only_sometimes_tells_of_its_zone_is_refused(info: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r'info\["zone"\] must be there .*, got none of world 1'):
        zones_of(np.array([False, True]), info)


def test_worlds_need_not_have_zones() -> None:
    infos: list[dict[str, Any]] = [
        {},
        {"final_info": {"steps": np.array([3])}},
        {"final_info": [{}]},
    ]
    for info in infos:
        assert zones_of(np.array([True]), info) is None


# Outcomes.


class Shown:
    """What `outcome_of` asks of worlds."""

    def __init__(self, mode: AutoresetMode = SAME_STEP) -> None:
        self.metadata, self.unwrapped = {"autoreset_mode": mode}, self


LASTS: dict[str, Callable[[NDArray[Any]], Any]] = {
    "array": lambda last: last,
    "float64": lambda last: last.astype(np.float64),
    "tensor": torch.tensor,
    "double tensor": lambda last: torch.tensor(last).double(),
    "list of tensors": lambda last: [torch.tensor(row) for row in last],
    "objects": lambda last: np.array([*last, None], dtype=object)[:-1],
    "objects that are tensors": lambda last: np.array(
        [*(torch.tensor(row) for row in last), None], dtype=object
    )[:-1],
}


@pytest.mark.parametrize("is_tensor", [False, True])
@pytest.mark.parametrize("form", LASTS)
@given(ends=st.lists(st.booleans(), min_size=1, max_size=5))
def test_where_an_episode_ended_the_outcome_is_its_end(
    form: str, is_tensor: bool, ends: list[bool]
) -> None:
    beginning = np.zeros((len(ends), 2), np.float32)
    last = np.arange(2 * len(ends), dtype=np.float32).reshape(-1, 2) + 1
    sensors = torch.tensor(beginning) if is_tensor else beginning
    is_over = torch.tensor(ends) if is_tensor else np.array(ends)
    env: Any = Shown()
    outcome = outcome_of(env, sensors, is_over, {"final_obs": LASTS[form](last)})
    assert type(outcome) is type(sensors)
    assert outcome.dtype == sensors.dtype
    assert outcome.tolist() == np.where(np.array(ends)[:, None], last, beginning).tolist()
    assert not sensors.any()  # what was shown is left as it is


@pytest.mark.parametrize("info", [{}, {"final_observation": np.zeros((2, 1))}])
def test_an_end_that_is_not_shown_is_refused(info: dict[str, Any]) -> None:
    env: Any = Shown()
    with pytest.raises(ValueError, match=r'info\["final_obs"\] must hold the last sensors'):
        outcome_of(env, np.zeros((2, 1)), np.array([False, True]), info)


# Worlds that overwrite what they have shown.


@vectors
def test_a_world_that_overwrites_its_last_sensors_is_refused_by_the_loop(vector: Any) -> None:
    env = vector([Steps, reused][::-1], autoreset_mode=SAME_STEP)
    agent = IAC(SensorimotorSpace.from_env(env), CONFIG, [0, 1])
    with pytest.raises(ValueError, match="must not overwrite what it has shown"):
        train(agent, env, 12)
    assert agent.n_decisions < 3
    env.close()


@vectors
def test_it_is_refused_by_the_reward(vector: Any) -> None:
    env = vector([reused], autoreset_mode=SAME_STEP)

    def live() -> None:
        wrapper = VectorProgressReward(env, CONFIG)
        wrapper.reset(seed=0)
        for _ in range(3):
            wrapper.step(np.zeros((1, 1), np.float32))

    with pytest.raises(ValueError, match=r"wrap it in torch_iac\.worlds\.vector\.CopiedSensors"):
        live()
    env.close()


@vectors
def test_wrapped_in_copies_it_is_right(tmp_path: Path, vector: Any) -> None:
    outcomes, _ = lived(tmp_path, vector([copied] * 2, autoreset_mode=SAME_STEP))
    assert outcomes == [[1, 2, 3, 1, 2, 3, 1, 2]] * 2


@vectors
def test_an_end_that_looks_like_a_beginning_is_no_matter(tmp_path: Path, vector: Any) -> None:
    """As where a robot comes home."""

    class Home(Steps):
        def _sense(self) -> Sensors:
            return np.array([self._count % 3], np.float32)

    outcomes, _ = lived(tmp_path, vector([Home], autoreset_mode=SAME_STEP))
    assert outcomes == [[1, 2, 0, 1, 2, 0, 1, 2]]


def test_tensors_that_are_overwritten_are_refused() -> None:
    env: Any = Shown()
    sensors = torch.zeros(2, 1)
    for last in (sensors, sensors.view(2, 1)):
        with pytest.raises(ValueError, match="must not overwrite what it has shown"):
            outcome_of(env, sensors, torch.tensor([True, False]), {"final_obs": last})


def test_a_copy_is_of_whatever_is_shown() -> None:
    world = iac.ProgressReward(CopiedSensors(Steps(reuses=True)), CONFIG)
    first, _ = world.reset(seed=0)
    world.step(np.zeros(1, np.float32))
    assert first.tolist() == [0.0]
