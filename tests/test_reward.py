"""Learning progress as a reward: what it is, when, and that nothing else of a world changes."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList
from numpy.typing import NDArray

import torch_iac_envs  # noqa: F401 - registers the worlds
from tests.agreement import check_step, oracle_of
from torch_iac import (
    AbsoluteProgress,
    HybridExperts,
    IACConfig,
    Improvement,
    ImprovementPredictor,
    KNNExperts,
    MetaPredictor,
    MLPExperts,
    Novelty,
    ProgressReward,
    Step,
    VectorProgressReward,
)
from torch_iac.internal.state import State
from torch_iac.reward import When

TOY_ROOM = "torch_iac_envs/ToyRoom-v0"
KINEMATIC = "torch_iac_envs/ToyRoomKinematic-v0"

SMALL = IACConfig(max_examples=20, window=8, delay=8)
"""Splits often, so that a short run shows much."""

Array = NDArray[Any]


class Echo(gym.Env[Array, Array]):
    """Its sensor reads the action, with noise if that is below 0; it pays 7 for each step.

    Its episodes end after `length` steps. It reuses its buffer within one, as worlds may.
    """

    def __init__(self, length: int = 10**6) -> None:
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gym.spaces.Box(-2.0, 2.0, (1,), np.float32)
        self.length = length

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.n_steps, self.buffer = 0, np.full(1, 0.5, np.float32)
        return self.buffer, {}

    def step(self, action: Array) -> tuple[Array, SupportsFloat, bool, bool, dict[str, Any]]:
        self.n_steps += 1
        self.buffer[0] = action[0] if action[0] >= 0 else self.np_random.uniform(-1, 1)
        return self.buffer, 7.0, self.n_steps == self.length, False, {"n": self.n_steps}


def actions_of(n: int) -> Array:
    return np.random.default_rng(0).uniform(-1, 1, (n, 1)).astype(np.float32)


def live(env: ProgressReward, n: int, seed: int | None = 0) -> tuple[list[float], list[Step]]:
    """Return rewards and steps of random actions."""
    env.reset(seed=seed)
    rewards, steps = [], []
    for action in actions_of(n):
        _, reward, terminated, _, info = env.step(action)
        assert env.last is not None
        rewards.append(reward)
        steps.append(env.last)
        assert info["iac"] == {
            "world_reward": 7.0,
            "error": env.last.errors.item(),
            "region": env.last.regions.item(),
            "progress": env.last.progress.item(),
        }
        if terminated:
            env.reset()
    return rewards, steps


def test_the_reward_is_the_oracles_progress_after_it_learnt() -> None:
    env = ProgressReward(Echo(), SMALL, scale=10.0)
    rewards, steps = live(env, 400)
    robot = oracle_of(SMALL)
    for reward, step in zip(rewards, steps, strict=True):
        check_step(env.agent.space, robot, step)
        action, sensors = (step.actions.item() + 1) / 2, (step.sensors.item() + 2) / 4
        learnt = robot.progress(robot.region_of([action, sensors]))
        assert reward == pytest.approx(10 * learnt, abs=1e-5)
    assert robot.n_regions > 10
    assert np.std(rewards) > 0.05


def test_when_chosen_the_reward_is_what_iac_goes_by() -> None:
    rewards, steps = live(ProgressReward(Echo(), SMALL, when="chosen", scale=2.0), 300)
    assert rewards == [2 * step.progress.item() for step in steps]
    assert rewards != live(ProgressReward(Echo(), SMALL, scale=2.0), 300)[0]


def test_any_drive_can_be_the_reward() -> None:
    rewards, _ = live(ProgressReward(Echo(), replace(SMALL, drive=AbsoluteProgress())), 200)
    plain, _ = live(ProgressReward(Echo(), SMALL), 200)
    assert rewards == np.abs(plain).tolist()
    assert min(plain) < 0


def test_novelty_rewards_what_was_new_when_it_was_chosen_and_nothing_the_first_time() -> None:
    config = replace(SMALL, drive=Novelty())
    rewards, steps = live(ProgressReward(Echo(), config, when="chosen"), 2)
    one, other = (
        np.array([(step.actions.item() + 1) / 2, (step.sensors.item() + 2) / 4]) for step in steps
    )
    assert rewards == [0.0, pytest.approx(np.linalg.norm(one - other), abs=1e-6)]
    assert live(ProgressReward(Echo(), config), 20)[0] == [0.0] * 20  # once learnt, nothing is new


def test_what_comes_after_an_end_is_no_outcome_of_it_and_nothing_is_forgotten() -> None:
    _, steps = live(ProgressReward(Echo(length=3), SMALL), 40)
    for number, (step, after) in enumerate(pairwise(steps), start=1):
        begins_anew = number % 3 == 0
        assert after.sensors.item() == (0.5 if begins_anew else step.outcomes.item())
        assert after.number == number
    assert steps[-1].regions.item() > 0


# What the experts know outlasts episodes and seeds.

Wrapper = ProgressReward | VectorProgressReward


def wrapped(kind: str, seeds: list[int] | None = None, config: IACConfig = SMALL) -> Wrapper:
    """Return a wrapper of either kind: of one world, or of two."""
    if kind == "single":
        return ProgressReward(Echo(3), config, seed=None if seeds is None else seeds[0])
    mode = AutoresetMode.SAME_STEP
    worlds = SyncVectorEnv([lambda: Echo(3)] * 2, autoreset_mode=mode)
    return VectorProgressReward(worlds, config, seeds=seeds)


def move(env: Wrapper, n: int, start: int = 0) -> list[Any]:
    """Take so many actions; return rewards and what was said of the experts."""
    seen = []
    for action in actions_of(start + n)[start:]:
        if isinstance(env, ProgressReward):
            _, reward, terminated, _, info = env.step(action)
            if terminated:
                env.reset()
        else:
            _, reward, _, _, info = env.step(np.stack([action, -action]))
        seen.append(
            [
                np.asarray(reward).tolist(),
                {k: np.asarray(v).tolist() for k, v in info["iac"].items()},
            ]
        )
    return seen


def same(one: State, other: State) -> bool:
    """Return whether two states have the same bits; where nothing is known they hold NaN."""
    return {name: of.numpy().tobytes() for name, of in one.items()} == {
        name: of.numpy().tobytes() for name, of in other.items()
    }


both_kinds = pytest.mark.parametrize("kind", ["single", "vector"])


@both_kinds
def test_a_reset_with_a_seed_seeds_the_world_and_leaves_the_experts(kind: str) -> None:
    env = wrapped(kind)
    env.reset(seed=5)
    agent = env.agent
    move(env, 30)
    before = env.state()
    env.reset(seed=5)
    assert env.agent is agent
    assert same(env.state(), before)
    world = env.env if isinstance(env, ProgressReward) else env.env.envs[0]
    assert world.np_random.bit_generator.state == np.random.default_rng(5).bit_generator.state


@pytest.mark.parametrize(
    ("given", "reset", "expected"),
    [
        (None, None, (0, 1)),
        (None, 7, (7, 8)),
        (None, [4, 2], (4, 2)),
        (None, [None, 9], (0, 9)),
        ([3, 1], 7, (3, 1)),
    ],
)
def test_experts_without_seeds_take_those_of_the_first_reset(
    given: list[int] | None, reset: int | list[int | None] | None, expected: tuple[int, int]
) -> None:
    env = wrapped("vector", given)
    env.reset(seed=reset)  # type: ignore[arg-type]
    assert env.agent.seeds == expected
    env.reset(seed=20)
    assert env.agent.seeds == expected
    if not isinstance(reset, list):
        alone = wrapped("single", given)
        alone.reset(seed=reset)
        assert alone.agent.seeds == expected[:1]


@both_kinds
def test_before_a_reset_experts_without_seeds_cannot_be_had(kind: str) -> None:
    with pytest.raises(ResetNeeded, match="reset must be called before the experts can be had"):
        _ = wrapped(kind).agent
    assert wrapped(kind, [3, 4]).agent.seeds[0] == 3


@both_kinds
def test_what_is_forgotten_is_learnt_again_in_the_same_way(kind: str) -> None:
    env = wrapped(kind, config=replace(SMALL, meta=MetaPredictor(hidden=(4,))))
    env.reset(seed=5)
    first = move(env, 40)
    env.forget()
    assert env.agent.n_decisions == 0
    assert env.last is None
    env.reset(seed=5)
    assert move(env, 40) == first
    env.reset(seed=5)
    assert move(env, 40) != first


@both_kinds
def test_a_state_goes_on_in_another_wrapper_with_its_seeds(kind: str) -> None:
    env, other = wrapped(kind), wrapped(kind)
    env.reset(seed=5)
    move(env, 30)
    other.load_state(env.state())
    for each in (env, other):
        each.reset(seed=9)  # which gives no seeds any more
    assert other.agent.seeds == env.agent.seeds
    assert move(other, 60, 30) == move(env, 60, 30)
    assert same(other.state(), env.state())


def test_a_state_of_others_is_refused_and_changes_nothing() -> None:
    env, other = wrapped("single", [3]), wrapped("vector", [3, 4])
    before = env.state()
    with pytest.raises(ValueError, match=r"seeds must be in the state, 1 of them, got \[3, 4\]"):
        env.load_state(other.state())
    with pytest.raises(ValueError, match="seeds must be in the state, 1 of them, got none"):
        env.load_state(env.agent.state())
    with pytest.raises(ValueError, match="n_decisions must be in the state, got none"):
        env.load_state({"seeds": torch.tensor([3])})
    assert same(env.state(), before)


EXPERTS = {
    "knn": SMALL,
    "network": replace(
        SMALL,
        meta=MetaPredictor(hidden=(4,)),
        experts=MLPExperts(hidden=(4,)),
        drive=Improvement(),
        improvement=ImprovementPredictor(hidden=(4,)),
    ),
    "hybrid": replace(SMALL, experts=HybridExperts(), shadows={"other": KNNExperts()}),
}


@both_kinds
@pytest.mark.parametrize("name", EXPERTS)
def test_for_evaluation_rewards_are_as_usual_and_nothing_is_learnt(kind: str, name: str) -> None:
    env = wrapped(kind, config=EXPERTS[name])
    env.reset(seed=5)
    move(env, 60)
    before = env.state()
    env.learning = False
    env.reset(seed=6)
    first = move(env, 30)
    env.reset(seed=6)
    assert move(env, 30) == first
    assert np.ptp([reward for reward, _ in first]) > 0
    assert same(env.state(), before)
    env.learning = True
    move(env, 1)
    assert not same(env.state(), before)


@both_kinds
def test_a_world_for_evaluation_shares_the_experts_whatever_becomes_of_them(kind: str) -> None:
    env = wrapped(kind)
    worlds = env.env
    other: Any = wrapped(kind).env
    with pytest.raises(ResetNeeded):
        env.for_evaluation(other)
    env.reset(seed=5)
    judged = env.for_evaluation(other)
    judged.reset(seed=1)
    for _ in range(2):
        move(env, 30)
        before = env.state()
        move(judged, 20)
        assert same(env.state(), before)
        assert judged.agent is env.agent
        env.load_state(before)
    assert (env.env, judged.env) == (worlds, other)
    assert (env.learning, judged.learning) == (True, False)


def test_a_world_for_evaluation_must_be_of_the_same_kind() -> None:
    env = wrapped("vector", [0, 1])
    for other in (SyncVectorEnv([Echo]), gym.make_vec("Pendulum-v1", 2)):
        with pytest.raises(ValueError, match="env must be like the one whose experts it shares"):
            env.for_evaluation(other)


def test_spaces_and_what_the_world_says_are_its_own() -> None:
    world = Echo()
    env = ProgressReward(world, SMALL)
    assert env.action_space is world.action_space
    assert env.observation_space is world.observation_space
    env.reset(seed=0)
    observation, _, terminated, truncated, info = env.step(np.array([0.25], np.float32))
    assert observation is world.buffer
    assert (terminated, truncated, info["n"]) == (False, False, 1)


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
@pytest.mark.parametrize(
    "arguments", [{}, {"outcomes": ["toy_distance"], "when": "chosen", "seed": 4}]
)
def test_gymnasium_finds_nothing_to_complain_about(arguments: dict[str, Any]) -> None:
    env = ProgressReward(gym.make(TOY_ROOM), **arguments)
    env.learning = False  # it asks for the same rewards after the same seed
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"when": "later"}, "when must be learnt or chosen, got later"),
        ({"scale": 0.0}, "scale must be finite and above 0, got 0.0"),
        ({"scale": float("inf")}, "scale must be finite and above 0, got inf"),
        ({"outcomes": ["toy"]}, r"outcomes must be sensors \(sensor_0\), got toy"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ProgressReward(Echo(), SMALL, **arguments)
    with pytest.raises(ValueError, match=message):
        VectorProgressReward(SyncVectorEnv([Echo]), SMALL, **arguments)


def test_wrong_actions_are_named_and_not_carried_out() -> None:
    world = Echo()
    env = ProgressReward(world, SMALL)
    with pytest.raises(ResetNeeded, match="reset must be called before step"):
        env.step(np.zeros(1, np.float32))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"action_0 must lie in \[-1, 1\], got 2 from agent 0"):
        env.step(np.array([2.0]))
    assert world.n_steps == 0


@pytest.mark.parametrize("wrap", [gym.wrappers.Autoreset, lambda env: env])
def test_a_world_that_goes_on_by_itself_after_an_end_is_refused(wrap: Any) -> None:
    env = ProgressReward(wrap(Echo(3)), SMALL)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(1, np.float32))
    with pytest.raises(ResetNeeded, match=r"when an episode is over; gymnasium\.wrappers"):
        env.step(np.zeros(1, np.float32))
    assert env.agent.n_decisions == 3


def test_a_wrapper_around_may_reset_it() -> None:
    env = ProgressReward(Echo(3), SMALL)
    outer = gym.wrappers.Autoreset(env)
    outer.reset(seed=0)
    for number in range(8):
        outer.step(np.full(1, 0.25, np.float32))
        if number % 4 != 3:
            assert env.last is not None
            assert env.last.outcomes.item() == 0.25
    assert env.agent.n_decisions == 6


KINDS_OF_NUMBERS: dict[str, Callable[[Array], Any]] = {
    "list": lambda x: x.tolist(),
    "big-endian": lambda x: x.astype(">f4"),
    "reversed": lambda x: x[::-1].copy()[::-1],
    "read-only": lambda x: np.frombuffer(x.tobytes(), np.float32),
    "float64": lambda x: x.astype(np.float64),
    "float16": lambda x: x.astype(np.float16),
    "tensor": torch.tensor,
    "learnt tensor": lambda x: torch.tensor(x, requires_grad=True),
}


@pytest.mark.parametrize("kind", KINDS_OF_NUMBERS)
def test_worlds_and_learners_may_use_numbers_of_any_kind(kind: str) -> None:
    cast = KINDS_OF_NUMBERS[kind]

    class Other(Echo):
        def reset(self, **arguments: Any) -> Any:
            observation, info = super().reset(**arguments)
            return cast(observation), info

        def step(self, action: Any) -> Any:
            number = action.detach().numpy() if isinstance(action, torch.Tensor) else action
            observation, *rest = super().step(np.array(number, np.float32))
            return cast(observation), *rest

    plain, other = ProgressReward(Echo(), SMALL), ProgressReward(Other(), SMALL)
    for env in (plain, other):
        env.reset(seed=0)
    for action in np.abs(actions_of(60)).astype(np.float16).astype(np.float32):
        assert other.step(cast(action))[1] == plain.step(action)[1]
    assert same(other.state(), plain.state())


# A vector of worlds.


@pytest.mark.parametrize("when", ["learnt", "chosen"])
def test_each_world_of_a_vector_is_rewarded_as_if_it_were_alone(when: When) -> None:
    worlds = SyncVectorEnv([Echo] * 3)
    env = VectorProgressReward(worlds, SMALL, seeds=[4, 5, 6], when=when)
    env.reset(seed=[0, 1, 2])
    alone = live(ProgressReward(Echo(), SMALL, seed=6, when=when), 120, seed=2)[0]
    rewards = []
    for action in actions_of(120):
        actions = np.stack([-action, action**2, action])
        _, reward, _, _, info = env.step(actions)
        assert isinstance(reward, np.ndarray)
        rewards.append(reward[2])
    assert rewards == alone
    assert info["iac"]["world_reward"].tolist() == [7.0] * 3
    assert info["iac"]["region"].shape == (3,)


def test_in_a_vector_the_outcome_of_an_end_is_the_end() -> None:
    worlds = SyncVectorEnv([lambda: Echo(3)] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    env = VectorProgressReward(worlds, SMALL)
    env.reset(seed=0)
    for number in range(1, 10):
        sensors, *_ = env.step(np.full((2, 1), 0.125 * (number % 3), np.float32))
        assert env.last is not None
        assert env.last.outcomes.tolist() == [[0.125 * (number % 3)]] * 2
        assert (sensors == 0.5).all() == (number % 3 == 0)


def test_worlds_that_would_show_their_beginning_as_an_outcome_are_refused() -> None:
    env = VectorProgressReward(SyncVectorEnv([lambda: Echo(1)]), SMALL)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="must be made with autoreset_mode SAME_STEP, got"):
        env.step(np.zeros((1, 1), np.float32))


def test_worlds_of_tensors_have_tensors_for_rewards() -> None:
    env = VectorProgressReward(gym.make_vec(KINEMATIC, num_envs=4), outcomes=["toy_distance"])
    env.reset(seed=0)
    _, reward, _, _, info = env.step(env.action_space.sample())
    assert isinstance(reward, torch.Tensor)
    assert all(isinstance(column, torch.Tensor) for column in info["iac"].values())


def test_what_the_experts_made_of_it_can_be_had_world_by_world() -> None:
    env = DictInfoToList(VectorProgressReward(SyncVectorEnv([Echo] * 2), SMALL))
    env.reset(seed=0)
    infos = env.step(np.zeros((2, 1), np.float32))[4]
    assert [set(info["iac"]) for info in infos] == [
        {"world_reward", "error", "region", "progress"}
    ] * 2


def test_there_are_as_many_seeds_as_worlds() -> None:
    with pytest.raises(ValueError, match=r"seeds must name one for each of 2 worlds, got \[1\]"):
        VectorProgressReward(SyncVectorEnv([Echo] * 2), seeds=[1])
