"""Worlds that break their promises: each is lived with, or refused in one sentence.

What was recorded before stays readable, and neither memory nor the number of regions grows without
bound.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import SyncVectorEnv
from numpy.typing import NDArray

from tests.test_memory_estimate import tensor_bytes
from torch_iac import IAC, IACConfig, MetaPredictor, MLPExperts, SensorimotorSpace
from torch_iac.memory_estimate import memory_needed
from torch_iac.runs.reader import load_run
from torch_iac.runs.recorder import Recorder
from torch_iac.training import train

CONFIG = IACConfig(n_candidates=5, max_examples=20, window=8, delay=8)
TROUBLE_AT = 30
UNIT = spaces.Box(0.0, 1.0, (2,), np.float32)
PUSH = spaces.Box(-1.0, 1.0, (1,), np.float32)

Sensors = NDArray[Any]
Bend = Callable[[Sensors], Sensors]


def nothing(sensors: Sensors) -> Sensors:
    return sensors


class Bent(gym.Env[Sensors, Sensors]):
    """Random sensors, of which the first reads the action; all are bent after some decisions.

    Args:
        bend: What becomes of the sensors.
        after: From which decision on; the first reading is number 0.
        action_space: Where actions lie.
        observation_space: Where sensors lie.
        metadata: Names, if any.
    """

    def __init__(
        self,
        bend: Bend = nothing,
        after: int = TROUBLE_AT,
        action_space: spaces.Space[Any] = PUSH,
        observation_space: spaces.Space[Any] = UNIT,
        metadata: dict[str, Any] | None = None,
    ) -> None:
        self.action_space, self.observation_space = action_space, observation_space
        self.metadata = metadata or {}
        self._bend, self._after, self._moment = bend, after, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Sensors, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self._moment = 0
        return self._sense(0.5), {}

    def step(self, action: Sensors) -> tuple[Sensors, SupportsFloat, bool, bool, dict[str, Any]]:
        self._moment += 1
        return self._sense((float(action[0]) + 1) / 2), 0.0, False, False, {}

    def _sense(self, echo: float) -> Sensors:
        box = self.observation_space
        assert isinstance(box, spaces.Box)
        share = self.np_random.random(box.shape)
        share[0] = min(max(echo, 0.0), 1.0)
        sensors = (box.low + share * (box.high - box.low)).astype(box.dtype)
        return self._bend(sensors) if self._moment >= self._after else sensors


def live(
    folder: Path, *makers: Callable[[], Bent], config: IACConfig = CONFIG, n_decisions: int = 60
) -> IAC:
    """Let an agent in each world live and be recorded."""
    env = SyncVectorEnv(makers, autoreset_mode=gym.vector.AutoresetMode.DISABLED)
    agent = IAC(SensorimotorSpace.from_env(env), config, range(len(makers)))
    with Recorder(folder, agent, env.metadata.get("zone_names")) as recorder:
        train(agent, env, n_decisions, recorder)
    return agent


def refusal(maker: Callable[[], Bent]) -> str:
    """Return what is said of a world whose spaces cannot be lived in."""
    with pytest.raises(ValueError, match=" must ") as refused:
        SensorimotorSpace.from_env(maker())
    return str(refused.value)


def set_first(value: float) -> Bend:
    def bend(sensors: Sensors) -> Sensors:
        sensors[0] = value
        return sensors

    return bend


# Readings that are none.


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 7.0, -1e30])
def test_a_reading_that_cannot_be_is_named_and_what_was_before_is_kept(
    tmp_path: Path, value: float
) -> None:
    message = rf"^sensor_0 must lie in \[0, 1\], got {value:g} from agent 1$".replace("+", r"\+")
    with pytest.raises(ValueError, match=message):
        live(tmp_path, Bent, lambda: Bent(set_first(value)))
    run = load_run(tmp_path)
    assert run.n_decisions == TROUBLE_AT - 1  # what the last of these led to is the bad reading
    assert np.isfinite(run.column("sensor/sensor_0")).all()
    assert not (tmp_path / "summary.json").exists()


def test_a_first_reading_that_cannot_be_leaves_a_run_without_decisions(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="sensor_0 must lie in"):
        live(tmp_path, lambda: Bent(set_first(math.nan), after=0))
    assert load_run(tmp_path).seeds == (0,)
    assert not list((tmp_path / "steps").iterdir())


@pytest.mark.parametrize("value", [1.0005, -0.0005])
def test_a_reading_just_outside_is_lived_with(tmp_path: Path, value: float) -> None:
    agent = live(tmp_path, lambda: Bent(set_first(value)))
    assert agent.n_decisions == 60
    assert load_run(tmp_path).column("sensor/sensor_0")[-1, 0] == np.float32(value)
    held = agent.examples.situations[: agent.examples.n_rows]
    assert held.min() >= 0
    assert held[held.isfinite()].max() <= 1


# Worlds in which there is nothing to learn.


def constant(sensors: Sensors) -> Sensors:
    return np.full_like(sensors, 0.25)


@pytest.mark.parametrize(
    "config",
    [CONFIG, IACConfig(**vars(CONFIG) | {"experts": MLPExperts(hidden=(4,), minibatches=1)})],
    ids=["knn", "mlp"],
)
def test_where_nothing_ever_changes_regions_and_memory_stay_within_what_was_estimated(
    tmp_path: Path, config: IACConfig
) -> None:
    n_decisions = 1500
    agent = live(tmp_path, lambda: Bent(constant, 0), config=config, n_decisions=n_decisions)
    run = load_run(tmp_path)
    leaves = run.regions.filter(run.regions["split_step"].to_numpy() == -1)
    assert sum(leaves["n_examples"].to_pylist()) <= n_decisions
    fewest = config.balance * config.max_examples  # that a child starts with
    assert len(leaves) <= n_decisions / fewest
    assert tensor_bytes(agent, {}) <= 2 * memory_needed(agent.space, config, 1, n_decisions).tables
    if config is CONFIG:
        assert run.column("error")[1:].max() == 0.0


def test_where_nothing_can_be_cut_regions_forget_instead_of_growing(tmp_path: Path) -> None:
    """Of three examples, no cut can leave half on either side."""
    config = IACConfig(n_candidates=1, max_examples=2, balance=0.5, window=2, delay=2)
    agent = live(tmp_path, lambda: Bent(constant, 0), config=config, n_decisions=1000)
    assert len(agent.tree.leaves()) == 1
    assert int(agent.examples.counts[0]) == 2
    assert tensor_bytes(agent.examples, {}) == tensor_bytes(IAC(agent.space, config).examples, {})


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.uint8, np.int64])
def test_sensors_may_be_numbers_of_any_kind(tmp_path: Path, dtype: type) -> None:
    box = spaces.Box(0, 200, (3,), dtype)
    config = IACConfig(**vars(CONFIG) | {"meta": MetaPredictor(memory=20)})
    agent = live(tmp_path, lambda: Bent(observation_space=box), config=config, n_decisions=100)
    assert agent.space.sensors[0].high == 200.0
    run = load_run(tmp_path)
    assert run.n_decisions == 100
    if np.issubdtype(dtype, np.integer):
        assert (run.column("sensor/sensor_1") % 1 == 0).all()


# Worlds that fail.


def test_what_a_world_raises_comes_through_and_what_was_before_is_kept(tmp_path: Path) -> None:
    def fall(_: Sensors) -> Sensors:
        raise ArithmeticError("the world fell apart")

    with pytest.raises(ArithmeticError, match="the world fell apart"):
        live(tmp_path, lambda: Bent(fall))
    assert load_run(tmp_path).n_decisions == TROUBLE_AT - 1


@pytest.mark.parametrize("bend", [lambda s: s[:1], lambda s: np.append(s, 0), lambda s: s[:, None]])
def test_a_reading_of_another_shape_is_refused(bend: Bend, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"shape|wrong dim"):
        live(tmp_path, lambda: Bent(bend))
    assert load_run(tmp_path).n_decisions == TROUBLE_AT - 1


@pytest.mark.parametrize("shape", [(2, 3), (1, 2), (2,), (2, 2, 1)])
def test_sensors_of_another_shape_are_refused_by_the_agent(shape: tuple[int, ...]) -> None:
    agent = IAC(SensorimotorSpace.from_env(Bent()), CONFIG, [0, 1])
    with pytest.raises(ValueError, match=r"sensors must have the shape \(agents, sensors\) = "):
        agent.act(np.zeros(shape, np.float32))


@pytest.mark.parametrize("zone", [-1, 2, 200])
def test_a_zone_that_the_world_does_not_name_is_refused(tmp_path: Path, zone: int) -> None:
    class Zoned(Bent):
        def step(
            self, action: Sensors
        ) -> tuple[Sensors, SupportsFloat, bool, bool, dict[str, Any]]:
            *rest, _ = super().step(action)
            return *rest, {"zone": zone if self._moment > 5 else 1}  # type: ignore[return-value]

    with pytest.raises(ValueError, match=rf"a zone must lie in \[0, 1\], got {zone}"):
        live(tmp_path, lambda: Zoned(metadata={"zone_names": ("here", "there")}))
    run = load_run(tmp_path)
    assert run.n_decisions == 5
    assert run.window_sums.counts.sum() == 5


# Spaces that cannot be lived in.

BOXES = {
    "dict": (spaces.Dict({"a": UNIT}), "the observation space must be a flat Box, got Dict"),
    "discrete": (spaces.Discrete(3), "the observation space must be a flat Box, got Discrete(3)"),
    "picture": (
        spaces.Box(0, 255, (4, 4, 3), np.uint8),
        "the observation space must be a flat Box, got Box(0, 255, (4, 4, 3), uint8)",
    ),
    "scalar": (
        spaces.Box(0.0, 1.0, (), np.float32),
        "the observation space must be a flat Box, got Box(0.0, 1.0, (), float32)",
    ),
    "unbounded": (
        spaces.Box(-np.inf, np.inf, (2,), np.float32),
        "the observation space must have finite bounds, got Box(-inf, inf, (2,), float32)",
    ),
    "half": (
        spaces.Box(0.0, np.inf, (2,), np.float32),
        "the observation space must have finite bounds, got Box(0.0, inf, (2,), float32)",
    ),
    "empty": (
        spaces.Box(0.0, 1.0, (0,), np.float32),
        "outcomes must name at least one dimension, got none",
    ),
    "point": (
        spaces.Box(0.5, 0.5, (1,), np.float32),
        "the bounds of sensor_0 must be finite and in order, got [0.5, 0.5]",
    ),
    "huge": (
        spaces.Box(-1e300, 1e300, (1,), np.float64),
        "the bounds of sensor_0 must be numbers that float32 holds well apart, "
        "got [-1e+300, 1e+300]",
    ),
    "narrow": (
        spaces.Box(1e9, 1e9 + 1, (1,), np.float64),
        "the bounds of sensor_0 must be numbers that float32 holds well apart, "
        "got [1000000000.0, 1000000001.0]",
    ),
    "tiny": (
        spaces.Box(0.0, 1e-40, (1,), np.float64),
        "the bounds of sensor_0 must be numbers that float32 holds well apart, got [0.0, 1e-40]",
    ),
}


@pytest.mark.parametrize("name", BOXES)
def test_a_space_that_cannot_be_lived_in_is_refused(name: str) -> None:
    box, sentence = BOXES[name]
    assert refusal(lambda: Bent(observation_space=box)).startswith(sentence)


@pytest.mark.parametrize(
    "box", [spaces.Discrete(2), spaces.Box(0, 3, (2,), np.int64), spaces.MultiBinary(2)]
)
def test_actions_must_be_real_numbers(box: spaces.Space[Any]) -> None:
    assert refusal(lambda: Bent(action_space=box)).startswith("the action space must be")


def test_a_world_without_actions_is_refused() -> None:
    box = spaces.Box(0.0, 1.0, (0,), np.float32)
    said = refusal(lambda: Bent(action_space=box))
    assert said == "actions must name at least one dimension, got none"


@pytest.mark.parametrize("names", [("a",), ("a", "b", "c"), ("a", "a")])
def test_names_must_be_those_of_the_sensors(names: tuple[str, ...]) -> None:
    said = refusal(lambda: Bent(metadata={"sensor_names": names}))
    assert said in (
        f"sensor_names must name 2 dimensions, got {names}",
        f"sensors must have different names, got {list(names)}",
    )


@pytest.mark.parametrize("bound", [1e29, 1e-20, 255.0])
def test_bounds_of_any_size_that_float32_tells_apart_are_lived_in(
    tmp_path: Path, bound: float
) -> None:
    box = spaces.Box(-bound, bound, (2,), np.float32)
    agent = live(tmp_path, lambda: Bent(action_space=box, observation_space=box))
    assert agent.n_decisions == 60
    run = load_run(tmp_path)
    assert np.isfinite(run.column("prediction/sensor_0")).all()
    assert len(np.unique(run.column("action/action_0"))) > 50
