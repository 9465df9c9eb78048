"""A world of one's own, with two actions and three sensors: a robot on a rail, with a lamp."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

Floats = NDArray[np.float32]


class LampWorld(gym.Env[Floats, Floats]):
    """A robot moves along a rail and flashes a lamp, which lights a wall at the rail's right end.

    What the wall reflects can be learnt, where it is near; the static on the radio cannot.

    Args:
        reach: How far the lamp shines, as a share of the rail.
        render_mode: `rgb_array` draws the rail.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium has it
        "action_names": ("speed", "lamp"),
        "sensor_names": ("place", "light", "static"),
        "zone_names": ("dark", "lit"),
        "render_modes": ("rgb_array",),
        "render_fps": 10,
    }
    action_space = Box(np.array([-1, 0], np.float32), np.array([1, 1], np.float32))
    observation_space = Box(np.zeros(3, np.float32), np.ones(3, np.float32))

    def __init__(self, reach: float = 0.5, render_mode: str | None = None) -> None:
        if not 0 < reach <= 1:
            raise ValueError(f"reach must lie in (0, 1], got {reach}")
        self.reach, self.render_mode = reach, render_mode
        self._sensors = np.zeros(3, np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Put the robot in the middle of the rail."""
        super().reset(seed=seed, options=options)
        self._sensors = np.array([0.5, 0.0, 0.0], np.float32)
        return self._sensors.copy(), self._info()

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Move, flash and look."""
        speed, lamp = map(float, action)
        place = min(max(float(self._sensors[0]) + 0.1 * speed, 0.0), 1.0)
        nearness = max(0.0, 1 - (1 - place) / self.reach)
        static = self.np_random.random()
        self._sensors = np.array([place, lamp * nearness, static], np.float32)
        return self._sensors.copy(), 0.0, False, False, self._info()

    def render(self) -> NDArray[np.uint8]:
        """Return a picture: the rail, the robot on it, and the wall as bright as it is lit."""
        picture = np.full((60, 240, 3), 255, np.uint8)
        picture[40:44, 20:220] = 128
        picture[10:50, 220:230] = 60 + 195 * self._sensors[1]
        left = 20 + round(190 * float(self._sensors[0]))
        picture[28:40, left : left + 10] = (0, 90, 160)
        return picture

    def _info(self) -> dict[str, Any]:
        return {"zone": int(self._sensors[0] > 1 - self.reach)}


gym.register("LampWorld-v0", "lamp_world:LampWorld")
