"""A maze whose only reward is at its far end: gymnasium-robotics' PointMaze, medium map.

A ball is pushed by two forces from one corner to the opposite one. It starts and ends within 0.25
of the middle of these cells; an episode ends with reward 1 when it is within 0.45 of the goal, and
with none after 600 steps of the simulation. Needs the extras `sb3` and `worlds`.
"""

from typing import Any

import gymnasium as gym
import gymnasium_robotics
import numpy as np
from gymnasium.spaces import Box
from gymnasium.wrappers import RepeatAction
from numpy.typing import NDArray

Array = NDArray[Any]
Positions = NDArray[np.float32]
"""Where the ball was, shape `(T, 2)`, in units of a maze cell's side."""

MAP = [
    [1, 1, 1, 1, 1, 1, 1, 1],
    [1, "r", 0, 1, 1, 0, 0, 1],
    [1, 0, 0, 1, 0, 0, 0, 1],
    [1, 1, 0, 0, 0, 1, 1, 1],
    [1, 0, 0, 1, 0, 0, 0, 1],
    [1, 0, 1, 0, 0, 1, 0, 1],
    [1, 0, 0, 0, 1, 0, "g", 1],
    [1, 1, 1, 1, 1, 1, 1, 1],
]
"""The medium map of gymnasium-robotics: 1 is wall, `r` the start, `g` the goal."""

HALF = len(MAP) / 2
"""The middle of the maze is at 0, its outer walls end so far from there."""

MOST_SPEED = 5.0
"""In each direction; the simulation keeps to it, but for a little."""

EPISODE = 600
"""Steps of the simulation."""

BINS = 4
"""Each free cell has so many by so many bins, of which is counted how many were visited."""


class FlatMaze(gym.ObservationWrapper[Array, Array, dict[str, Array]]):
    """The ball's place and speed, shape `(4,)`, clipped to bounds; the goal's is left out."""

    def __init__(self, env: gym.Env[dict[str, Array], Array]) -> None:
        super().__init__(env)
        most = np.array([HALF, HALF, MOST_SPEED, MOST_SPEED], np.float32)
        self.observation_space = Box(-most, most)

    def observation(self, observation: dict[str, Array]) -> Array:
        """Return place and speed."""
        assert isinstance(self.observation_space, Box)
        low, high = self.observation_space.low, self.observation_space.high
        return np.clip(observation["observation"].astype(np.float32), low, high)


class Diary(gym.Wrapper[Array, Array, Array, Array]):
    """Keeps what became of every decision.

    Attributes:
        places: Where the ball was after each.
        rewards: What the maze gave for it: 1 at the goal, else 0.
        ends: Whether an episode ended with it.
    """

    def __init__(self, env: gym.Env[Array, Array]) -> None:
        super().__init__(env)
        self.places: list[Array] = []
        self.rewards: list[float] = []
        self.ends: list[bool] = []

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Take a decision, and note it."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.places.append(observation[:2])
        self.rewards.append(float(float(reward) > 0))
        self.ends.append(terminated or truncated)
        return observation, self.rewards[-1], terminated, truncated, info


def make_maze(hold: int) -> Diary:
    """Return the maze with a diary; each action is held for some steps of the simulation."""
    gym.register_envs(gymnasium_robotics)
    options: dict[str, Any] = {"maze_map": MAP, "max_episode_steps": EPISODE}
    maze = gym.make("PointMaze_Medium-v3", disable_env_checker=True, **options)
    return Diary(RepeatAction(FlatMaze(maze), hold))


def coverage(places: Positions) -> NDArray[np.float64]:
    """Return which share of the bins of all free cells was visited by then, shape `(T,)`."""
    column, row = np.floor((places * [1, -1] + HALF) * BINS).astype(int).T
    is_free = np.kron(np.array(MAP) != "1", np.ones((BINS, BINS))) > 0
    known, first = np.unique(row * len(is_free) + column, return_index=True)
    counted = is_free.ravel()[known]
    found = np.zeros(len(places))
    found[first[counted]] = 1
    return np.asarray(found.cumsum() / is_free.sum())
