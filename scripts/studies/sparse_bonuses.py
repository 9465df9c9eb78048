"""Bonuses for exploration, beside that of learning progress: two published ones, kept small.

Random network distillation (RND) rewards what a network cannot predict yet of another one's output,
which was drawn once. The intrinsic curiosity module (ICM) rewards what cannot be predicted of the
next observation's features, which are those that tell the action.

Source: Burda, Edwards, Storkey and Klimov (2019), "Exploration by random network distillation";
Pathak, Agrawal, Efros and Darrell (2017), "Curiosity-driven exploration by self-supervised
prediction".

Shapes: `B` transitions of a batch, `S` numbers of an observation, `C` of an action.
"""

from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.wrappers.utils import RunningMeanStd
from numpy.typing import NDArray
from torch import Tensor, nn

from scripts.studies.sparse_maze import Diary

Array = NDArray[Any]

HIDDEN = 64
"""Units of each hidden layer."""

FEATURES = 32
"""Numbers that describe an observation."""

BATCH = 64
"""Transitions that a gradient step is made of."""

MEMORY = 1000
"""They are drawn from the last so many."""

EVERY = 4
"""Decisions between two gradient steps."""

RATE = 1e-3
"""Adam's learning rate."""

FORWARD_SHARE = 0.2
"""How much the loss of ICM's forward model counts; the inverse model's counts the rest."""

MOST_SIGHT = 5.0
"""Networks see observations in standard deviations from their mean, clipped to this."""

MOST_BONUS = 1.0
"""Bonuses, once normalised, are clipped to this; what the goal gives is 1."""

TINY = 1e-8
"""Added to variances, so that none is 0."""


class Curiosity(Protocol):
    """What says how new a transition is, and learns from it."""

    def surprise(self, before: Tensor, actions: Tensor, after: Tensor) -> Tensor:
        """Return how new transitions are, shape `(B,)`.

        Args:
            before: Observations, normalised, shape `(B, S)`.
            actions: What was done, shape `(B, C)`.
            after: The next observations, normalised, shape `(B, S)`.
        """

    def loss(self, before: Tensor, actions: Tensor, after: Tensor) -> Tensor:
        """Return what learning from them makes less."""

    def parameters(self) -> Any:
        """Return the weights."""


class RND(nn.Module):
    """The error with which a random network's output for the next observation is predicted."""

    def __init__(self, n_sensors: int) -> None:
        super().__init__()
        self.target = mlp(n_sensors, FEATURES).requires_grad_(False)
        self.predictor = mlp(n_sensors, FEATURES)

    def surprise(self, before: Tensor, actions: Tensor, after: Tensor) -> Tensor:
        """Return the mean squared errors."""
        del before, actions
        errors: Tensor = self.predictor(after) - self.target(after)
        return errors.square().mean(dim=1)

    def loss(self, before: Tensor, actions: Tensor, after: Tensor) -> Tensor:
        """Return the predictor's loss."""
        return self.surprise(before, actions, after).mean()


class ICM(nn.Module):
    """The error with which the features of the next observation are predicted."""

    def __init__(self, n_sensors: int, n_actions: int) -> None:
        super().__init__()
        self.features = mlp(n_sensors, FEATURES)
        self.inverse_model = mlp(2 * FEATURES, n_actions)
        self.forward_model = mlp(FEATURES + n_actions, FEATURES)

    def surprise(self, before: Tensor, actions: Tensor, after: Tensor) -> Tensor:
        """Return half the squared errors."""
        return self._forward_errors(self.features(before), actions, self.features(after))

    def loss(self, before: Tensor, actions: Tensor, after: Tensor) -> Tensor:
        """Return the loss of both models, by which the features are learnt too."""
        first, second = self.features(before), self.features(after)
        told = self.inverse_model(torch.cat([first, second], dim=1))
        inverse: Tensor = (told - actions).square().mean()
        forward = self._forward_errors(first, actions, second).mean()
        return (1 - FORWARD_SHARE) * inverse + FORWARD_SHARE * forward

    def _forward_errors(self, first: Tensor, actions: Tensor, second: Tensor) -> Tensor:
        predicted: Tensor = self.forward_model(torch.cat([first, actions], dim=1))
        squares: Tensor = (predicted - second).square()
        return squares.sum(dim=1) / 2


def mlp(n_in: int, n_out: int) -> nn.Sequential:
    """Return a network with two hidden layers."""
    return nn.Sequential(
        *(nn.Linear(n_in, HIDDEN), nn.ReLU()),
        *(nn.Linear(HIDDEN, HIDDEN), nn.ReLU()),
        nn.Linear(HIDDEN, n_out),
    )


def shapes_of(env: gym.Env[Array, Array]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the shapes of observations and of actions."""
    assert isinstance(env.observation_space, Box)
    assert isinstance(env.action_space, Box)
    return env.observation_space.shape, env.action_space.shape


class CuriosityReward(gym.Wrapper[Array, Array, Array, Array]):
    """A wrapper whose reward is how new each transition is; it learns from the last ones.

    Args:
        env: What is explored.
        curiosity: What says how new they are.
        seed: Seeds which transitions it learns from.
    """

    def __init__(self, env: gym.Env[Array, Array], curiosity: Curiosity, seed: int) -> None:
        super().__init__(env)
        self._curiosity = curiosity
        self._adam = torch.optim.Adam(curiosity.parameters(), lr=RATE)
        self._draw = np.random.default_rng(seed)
        (n_sensors,), (n_actions,) = shapes_of(env)
        self._seen = RunningMeanStd(shape=(n_sensors,))
        self._memory = [
            np.zeros((MEMORY, size), np.float32) for size in (n_sensors, n_actions, n_sensors)
        ]
        self._n_decisions = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode; what was learnt stays."""
        self._observation, info = self.env.reset(seed=seed, options=options)
        return self._observation, info

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Take an action; the reward is how new the transition is, before it is learnt from."""
        after, _, terminated, truncated, info = self.env.step(action)
        self._seen.update(after[None])
        place = self._n_decisions % MEMORY
        for memory, now in zip(self._memory, (self._observation, action, after), strict=True):
            memory[place] = now
        self._observation = after
        self._n_decisions += 1
        with torch.no_grad():
            reward = self._curiosity.surprise(*self._transitions(np.array([place]))).item()
        if self._n_decisions >= BATCH and self._n_decisions % EVERY == 0:
            self._learn()
        return after, reward, terminated, truncated, info

    def _learn(self) -> None:
        rows = self._draw.integers(min(self._n_decisions, MEMORY), size=BATCH)
        self._adam.zero_grad()
        self._curiosity.loss(*self._transitions(rows)).backward()  # type: ignore[no-untyped-call]
        self._adam.step()

    def _transitions(self, rows: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """Return transitions of the memory, observations normalised."""
        before, actions, after = (torch.from_numpy(memory[rows]) for memory in self._memory)
        return self._sight(before), actions, self._sight(after)

    def _sight(self, observations: Tensor) -> Tensor:
        mean, std = self._seen.mean, np.sqrt(self._seen.var + TINY)
        scaled = (observations - torch.from_numpy(mean)) / torch.from_numpy(std)
        return scaled.clip(-MOST_SIGHT, MOST_SIGHT).float()


class Added(gym.Wrapper[Array, Array, Array, Array]):
    """A wrapper whose reward is the maze's own, and a share of the bonus.

    The bonus is normalised as by Burda et al.: divided by the running standard deviation of its
    discounted sums. Of the first decisions there is none, since what gives it knows nothing yet.

    Args:
        env: Gives the bonus as its reward.
        diary: Knows what the maze itself gave.
        coefficient: What the bonus is multiplied by.
        gamma: How much the next decision's counts.
        start: Of how many decisions there is none.
    """

    def __init__(
        self,
        env: gym.Env[Array, Array],
        diary: Diary,
        coefficient: float,
        gamma: float,
        start: int,
    ) -> None:
        super().__init__(env)
        self._diary, self._coefficient = diary, coefficient
        self._gamma, self._start = gamma, start
        self._sums = RunningMeanStd(shape=())
        self._sum = 0.0

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Take an action."""
        observation, bonus, terminated, truncated, info = self.env.step(action)
        reward = self._diary.rewards[-1]
        if len(self._diary.rewards) > self._start:
            reward += self._coefficient * self._normalised(float(bonus))
        return observation, reward, terminated, truncated, info

    def _normalised(self, bonus: float) -> float:
        self._sum = self._gamma * self._sum + bonus
        self._sums.update(np.array([self._sum]))
        return float(np.clip(bonus / np.sqrt(self._sums.var + TINY), -MOST_BONUS, MOST_BONUS))
