"""The study of a sparse reward: bonuses, what is measured, and runs that are kept."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

NEEDS = "needs the maze and SB3: pip install 'torch_iac[sb3,worlds]'"
pytest.importorskip("gymnasium_robotics", reason=NEEDS)
pytest.importorskip("stable_baselines3", reason=NEEDS)
pytestmark = pytest.mark.filterwarnings("default")  # they have warnings of their own

from scripts.studies.sparse_bonuses import ICM, RND, Added, Curiosity, CuriosityReward  # noqa: E402
from scripts.studies.sparse_maze import Diary, coverage, make_maze  # noqa: E402
from scripts.studies.sparse_reward import (  # noqa: E402
    COEFFICIENTS,
    MEASURES,
    Study,
    improvement,
    main,
)
from scripts.studies.sparse_runs import (  # noqa: E402
    BONUSES,
    NONE,
    PROGRESS,
    Learner,
    Outcome,
    Task,
    learn,
    run,
)

Array = NDArray[Any]

SMALL = Task(NONE, 1.0, 3, steps=80, tests=1, learner=Learner(learning_starts=40, batch_size=8))


class Steady(gym.Env[Array, Array]):
    """Its observations are given, one after the other; its rewards are 1, 2, 3, ..."""

    observation_space = Box(-1.0, 1.0, (4,))
    action_space = Box(-1.0, 1.0, (2,))

    def __init__(self, observations: Array) -> None:
        self.observations, self.n = observations.astype(np.float32), 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return self.observations[0], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        del action
        self.n += 1
        now = self.observations[self.n % len(self.observations)]
        return now, float(self.n), False, False, {}


@pytest.fixture
def maze() -> Iterator[Diary]:
    env = make_maze(5)
    yield env
    env.close()


def test_the_maze_shows_bounded_flat_boxes(maze: Diary) -> None:
    assert isinstance(maze.observation_space, Box)
    assert maze.observation_space.is_bounded()
    assert maze.reset(seed=0)[0] in maze.observation_space
    assert maze.step(np.ones(2, np.float32))[0] in maze.observation_space


def test_a_diary_has_every_decision_and_an_episode_lasts_for_600_steps(maze: Diary) -> None:
    maze.reset(seed=0)
    for _ in range(125):
        observation, reward, terminated, truncated, _ = maze.step(np.ones(2, np.float32))
        assert maze.places[-1] == pytest.approx(observation[:2])
        assert (maze.rewards[-1], maze.ends[-1]) == (reward, terminated or truncated)
        if truncated:
            maze.reset()
    assert np.flatnonzero(maze.ends).tolist() == [119]


def test_coverage_counts_each_bin_of_a_free_cell_once() -> None:
    in_first_cell = [[-2.9, 2.9], [-2.9, 2.9], [-2.6, 2.9], [-2.9, 2.6]]
    in_wall = [[-3.9, 3.9], [3.9, -3.9]]
    found = coverage(np.array(in_first_cell + in_wall, np.float32))
    n_bins = 26 * 16
    assert (found * n_bins).round(9).tolist() == [1, 1, 2, 3, 3, 3]


@pytest.mark.parametrize("make", [lambda: RND(4), lambda: ICM(4, 2)], ids=["RND", "ICM"])
def test_what_is_met_often_is_less_of_a_surprise(make: Any) -> None:
    torch.manual_seed(0)
    draw = np.random.default_rng(0)
    env = CuriosityReward(Steady(draw.uniform(-1, 1, (3, 4))), make(), seed=0)
    env.reset()
    rewards = [float(env.step(np.ones(2, np.float32))[1]) for _ in range(300)]
    assert np.mean(rewards[-30:]) < 0.1 * np.mean(rewards[30:60])


def test_rnd_is_surprised_by_what_it_did_not_meet() -> None:
    torch.manual_seed(0)
    rnd: Curiosity = RND(2)
    adam = torch.optim.Adam(rnd.parameters(), lr=1e-3)
    nothing, met = torch.zeros(64, 2), torch.rand(64, 2)
    target = [weight.clone() for weight in rnd.target.parameters()]  # type: ignore[attr-defined]
    for _ in range(300):
        adam.zero_grad()
        rnd.loss(nothing, nothing, met).backward()  # type: ignore[no-untyped-call]
        adam.step()
    assert rnd.surprise(nothing, nothing, -3 * met).mean() > 5 * rnd.loss(nothing, nothing, met)
    kept = zip(target, rnd.target.parameters(), strict=True)  # type: ignore[attr-defined]
    assert all(torch.equal(before, after) for before, after in kept)


def test_icm_weighs_the_losses_of_its_two_models_as_in_the_paper() -> None:
    icm = ICM(4, 2)
    before, actions, after = torch.rand(8, 4), torch.rand(8, 2), torch.rand(8, 4)
    first, second = icm.features(before), icm.features(after)
    inverse = icm.inverse_model(torch.cat([first, second], dim=1)) - actions
    forward = icm.forward_model(torch.cat([first, actions], dim=1)) - second
    surprise = 0.5 * (forward**2).sum(dim=1)
    torch.testing.assert_close(icm.surprise(before, actions, after), surprise)
    loss = 0.8 * (inverse**2).mean() + 0.2 * surprise.mean()
    torch.testing.assert_close(icm.loss(before, actions, after), loss)


@given(gamma=st.floats(0, 0.99), coefficient=st.floats(0, 10), start=st.integers(0, 5))
def test_a_bonus_is_divided_by_the_deviation_of_its_discounted_sums(
    gamma: float, coefficient: float, start: int
) -> None:
    diary = Diary(Steady(np.zeros((1, 4))))
    env = Added(diary, diary, coefficient, gamma, start)
    env.reset()
    rewards = [float(env.step(np.zeros(2, np.float32))[1]) for _ in range(8)]
    assert rewards[:start] == [1.0] * start  # a diary says 1 for what is above 0
    sums, last = [], 0.0
    for _ in range(start, 8):
        last = gamma * last + 1.0
        sums.append(last)
    expected = 1 + coefficient * np.clip(1 / np.sqrt(np.var(sums) + 1e-8), -1, 1)
    assert rewards[-1] == pytest.approx(expected, rel=0.01)


def outcome(rewards: list[float], ends: list[int], **other: Any) -> Outcome:
    """Return a run that stood still."""
    is_end = np.isin(np.arange(len(rewards)), ends)
    places = np.full((len(rewards), 2), [-2.5, 2.5], np.float32)
    kept: dict[str, Any] = {"passed": np.array([True, False]), **other}
    return Outcome(places, np.array(rewards, np.float32), is_end, **kept)


def test_success_is_that_of_the_episodes_that_end_in_a_window() -> None:
    run = outcome([0, 1, 0, 0, 0, 0, 1, 1, 1, 0, 0, 0], ends=[2, 4, 7, 8])
    np.testing.assert_equal(run.successes(1), [0.75])
    np.testing.assert_equal(run.successes(3), [1.0, 0.5, 1.0])
    np.testing.assert_equal(run.successes(4), [1.0, 0.0, 1.0, np.nan])
    assert run.first_success == 2
    assert outcome([0, 0, 0], ends=[2]).first_success == 4


def test_an_improvement_is_to_more_success_sooner() -> None:
    good = [outcome([0, 1, 1, 1], ends=[3], passed=np.array([True]))] * 2
    bad = [outcome([0, 0, 0, 0], ends=[3], passed=np.array([False]))] * 2
    found = [improvement(measure, good, bad).value for measure in MEASURES]
    assert found == [1.0, 1.0, 1.0, 0.5]


@pytest.fixture(scope="module")
def learnt() -> dict[str, Outcome]:
    """A small run with each bonus, all with one seed."""
    return {bonus: learn(replace(SMALL, bonus=bonus)) for bonus in BONUSES}


def test_runs_of_a_seed_begin_alike_and_then_the_bonus_tells(learnt: dict[str, Outcome]) -> None:
    alone = learnt[NONE]
    for bonus in BONUSES[1:]:
        assert np.array_equal(learnt[bonus].places[:40], alone.places[:40])
        # There is no progress before 300 errors.
        tells = not np.array_equal(learnt[bonus].places, alone.places)
        assert tells == (bonus != PROGRESS)
    assert len(alone.places) == len(alone.rewards) == len(alone.ends) == 80
    assert alone.passed.shape == (1,)


def test_the_same_seed_gives_the_same_run(learnt: dict[str, Outcome]) -> None:
    again = learn(replace(SMALL, bonus="icm"))
    assert np.array_equal(again.places, learnt["icm"].places)


def test_a_run_that_is_kept_is_not_run_again(learnt: dict[str, Outcome], tmp_path: Path) -> None:
    tasks = [replace(SMALL, bonus=bonus) for bonus in BONUSES]
    for task in tasks:
        learnt[task.bonus].write(task, tmp_path)
    for task, kept in zip(tasks, run(tasks, tmp_path, 1), strict=True):
        for name, column in vars(kept).items():
            assert np.array_equal(column, vars(learnt[task.bonus])[name])
    longer = replace(SMALL, steps=150)
    with pytest.raises(ValueError, match=f"out must hold runs .* got {tmp_path}"):
        run([longer], tmp_path, 1)


def test_a_study_of_kept_runs_is_printed_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    draw = np.random.default_rng(0)
    for bonus, coefficient in COEFFICIENTS.items():
        for seed in range(2):
            rewards = draw.integers(2, size=240).astype(float).tolist()
            task = Task(bonus, coefficient, seed, steps=240)
            outcome(rewards, ends=list(range(5, 240, 6))).write(task, tmp_path)
    main(Study(seeds=2, steps=240, out=tmp_path))
    printed = capsys.readouterr().out
    assert "| learning progress (2) | " in printed
    assert "| RND | 0." in printed
    assert (tmp_path / "sparse_reward.png").stat().st_size > 10_000
