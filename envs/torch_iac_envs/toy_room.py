"""`ToyRoom`, the world of the paper: a robot, a toy and three kinds of sound."""

import os
import sys
from copy import deepcopy
from typing import Any, ClassVar, Self, SupportsFloat

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from torch_iac_envs import room as layout
from torch_iac_envs.bodies import SLICE
from torch_iac_envs.physics import Command, Physics, Vector, resting_state
from torch_iac_envs.room import Picture, Room, check_argument
from torch_iac_envs.state import pack_commands, pack_random, unpack_commands, unpack_random

Observation = NDArray[np.float32]
"""What the robot senses, shape `(sensors,)`: distances in metres, a cosine and a sine."""
Action = NDArray[np.float32]
"""Left wheel and right wheel in [-1, 1], sound in [0, 1], shape `(3,)`."""
State = dict[str, NDArray[Any]]
"""What `get_state` returns; it says the shapes."""

PICTURES_A_SECOND = round(1 / SLICE)
"""How many pictures of a decision there are a second of its time."""


class ToyRoom(gym.Env[Observation, Action]):
    """A two-wheeled robot and a toy that obeys its sounds, in a square room, by pybullet.

    An action sets the two wheels' speeds and the frequency of a sound for one decision, at the end
    of which the robot stands again. With a sound of at most 1/3 (f1) the toy moves off fast in
    a random direction and bounces off the walls; at most 2/3 (f2) it stops; above (f3) it jumps
    into the robot. `info["zone"]` says which (0, 1, 2), for analysis: it is no sensor.

    The names of the actions and of the sensors are in `metadata`, under `"action_names"` and
    `"sensor_names"`, the sensors' units under `"sensor_units"`. A wall beam leaves from the
    robot's centre, the first one straight ahead and the others anticlockwise. The toy's distance
    runs from the robot's centre to the toy's surface. Its direction is read in the robot's frame;
    while the toy is in the robot there is none, and both its cosine and its sine are 0.

    Args:
        render_mode: None, `"rgb_array"` for pictures, `"rgb_array_list"` for every picture of the
            last decision, one a tenth of a second, or `"human"` for a window.
        width: Width of the pictures (pixels).
        height: Height of the pictures (pixels).
        beams: Number of infra-red beams to the walls.
        toy_direction: Whether the toy's direction is sensed.
        sensor_noise: Standard deviation of each distance (m). The toy's direction gets twice this
            number in radians: what it would get if read half a metre away.
        actuator_noise: Standard deviation of each wheel's speed, as a share of full speed.
        f1_end: The highest sound of f1, in [0, 1].
        f2_end: The highest sound of f2, in [`f1_end`, 1]; above it is f3.
        keyframe_every: Decisions between two rebuildings of the physics, from which a state can
            be resumed exactly. The trajectory depends on it, in its last digits.
        substeps: Physics steps in a tenth of a second.

    Attributes:
        room: The room's measures, a `Room`.
        metadata: Gymnasium's, with the names and units above and `"zone_names"`.

    Raises:
        ValueError: An argument is outside its range.
        RuntimeError: A window is asked for where there is no display.

    Source: Oudeyer and Kaplan (2004), section 2.2 and figure 1; that there is noise, Oudeyer,
    Kaplan and Hafner (2007). They say neither how much nor how many beams there are; the toy's
    direction is this library's, since without it f2 cannot be learnt.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - the type that gymnasium.Env declares
        "render_modes": ["rgb_array", "rgb_array_list", "human"],
        "render_fps": 2,
    }
    room: ClassVar[Room] = Room()

    def __init__(
        self,
        *,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
        beams: int = 8,
        toy_direction: bool = True,
        sensor_noise: float = 0.01,
        actuator_noise: float = 0.02,
        f1_end: float = layout.F1_END,
        f2_end: float = layout.F2_END,
        keyframe_every: int = 100,
        substeps: int = 8,
    ) -> None:
        _check_render_mode(render_mode)
        check_argument("width", width)
        check_argument("height", height)
        check_argument("beams", beams)
        check_argument("sensor_noise", sensor_noise)
        check_argument("actuator_noise", actuator_noise)
        check_argument("keyframe_every", keyframe_every)
        check_argument("substeps", substeps)
        self.render_mode = render_mode
        self._toy_direction = toy_direction
        self._sensor_noise = sensor_noise
        self._actuator_noise = actuator_noise
        self._zone_ends = layout.zone_ends(f1_end, f2_end)
        self._keyframe_every = keyframe_every
        self._declare_spaces(beams)
        self._keyframe: Vector | None = None
        self._commands: list[Command] = []
        self._film: list[Picture] | None = [] if render_mode == "rgb_array_list" else None
        self._physics = Physics(
            self.room, beams, substeps, render_mode == "human", picture_size=(width, height)
        )

    def _declare_spaces(self, beams: int) -> None:
        low, high = layout.sensor_bounds(self.room, beams, self._toy_direction)
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float32)
        self.action_space = gym.spaces.Box(
            np.array(layout.ACTION_LOW, np.float32),
            np.array(layout.ACTION_HIGH, np.float32),
            dtype=np.float32,
        )
        self.metadata = {
            **type(self).metadata,
            "action_names": layout.ACTION_NAMES,
            "sensor_names": layout.sensor_names(beams, self._toy_direction),
            "sensor_units": layout.sensor_units(beams, self._toy_direction),
            "zone_names": layout.ZONE_NAMES,
        }
        if self.render_mode == "rgb_array_list":
            self.metadata["render_fps"] = PICTURES_A_SECOND

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put robot and toy anywhere in the room and return what the robot senses.

        Args:
            seed: Starts the world's random numbers anew; without it they go on.
            options: Not used.

        Returns:
            What is sensed, shape `(sensors,)`, distances in metres; and nothing.
        """
        super().reset(seed=seed, options=options)
        robot = self.np_random.uniform(-self.room.robot_reach, self.room.robot_reach, 2)
        toy = self.np_random.uniform(-self.room.toy_reach, self.room.toy_reach, 2)
        heading = self.np_random.uniform(-np.pi, np.pi)
        self._seat_keyframe(resting_state(self.room, tuple(robot), heading, tuple(toy)))
        self._clear_film()
        return self._sense(), {}

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take one decision.

        Args:
            action: Left wheel and right wheel in [-1, 1], sound in [0, 1]; shape `(3,)`.

        Returns:
            What is sensed afterwards, shape `(sensors,)`, distances in metres; a reward of 0,
            False, False and, in `info["zone"]`, the sound's zone (0, 1, 2).

        Raises:
            RuntimeError: The world was not reset.
            ValueError: The action's shape or its values are not as above.
        """
        self._check_started("step")
        action = self._checked(action)
        zone = sum(int(action[2] > end) for end in self._zone_ends)
        self._clear_film()
        self._decide(self._command(action, zone), self._film)
        return self._sense(), 0.0, False, False, {"zone": zone}

    def render(self) -> Picture | list[Picture] | None:  # type: ignore[override]
        """Return a picture, shape `(height, width, 3)`, if the mode is `"rgb_array"`.

        If it is `"rgb_array_list"`, return those of the last decision, the last of them at its end;
        none if the world was reset since.

        Raises:
            RuntimeError: The world was not reset.
        """
        if self.render_mode not in ("rgb_array", "rgb_array_list"):
            return None
        self._check_started("render")
        return self._physics.picture() if self._film is None else list(self._film)

    def close(self) -> None:
        """Close the physics engine; closing twice is allowed."""
        self._physics.close()

    def __copy__(self) -> Self:
        return deepcopy(self)  # two worlds on one engine would move each other's bodies

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become the copy, or the world that was pickled: the same physics, in another client."""
        vars(self).update(state)
        keyframe, commands = self._keyframe, self._commands
        if keyframe is not None and self._physics.is_open:
            self._physics.seat(keyframe)
            for command in commands:
                self._physics.advance(command)

    def get_state(self) -> State:
        """Return the whole state, as a dict of arrays.

        `keyframe` is the physical state at the last keyframe, shape `(30,)`; `commands` are the
        decisions since, noise included, shape `(n, 5)`; `random` is the random numbers' state,
        shape `(6,)`; `present` is the physical state now, by which `set_state` checks itself, laid
        out as `keyframe`: for robot and then toy position (m), quaternion, velocity (m/s) and spin
        (rad/s), between them angle and speed of the left and the right wheel.

        Raises:
            RuntimeError: The world was not reset.
        """
        self._check_started("get_state")
        return {
            "keyframe": np.array(self._keyframe),
            "commands": pack_commands(self._commands),
            "random": pack_random(self.np_random),
            "present": self._physics.read(),
        }

    def set_state(self, state: State) -> None:
        """Go on from what `get_state` returned, exactly; the arguments must be the same as then.

        The physics is rebuilt at the keyframe and the decisions since are simulated again.
        An environment made by `gymnasium.make` must be reset first.

        Raises:
            ValueError: There are more commands than fit between two keyframes.
            RuntimeError: The physical state reached is not the one saved, as with other arguments
                or another version of the engine; the world must then be reset.
        """
        commands = unpack_commands(state["commands"])
        if len(commands) >= self._keyframe_every:
            raise ValueError(
                f"a state must hold fewer commands than keyframe_every = {self._keyframe_every}, "
                f"got {len(commands)}"
            )
        self._clear_film()
        self._seat_keyframe(np.array(state["keyframe"]))
        for command in commands:
            self._decide(command)
        self._check_reached(state["present"])
        self.np_random = unpack_random(state["random"])

    @property
    def full_state(self) -> State:
        """What `get_state` returns; setting it is `set_state`. A vector of worlds can reach it.

        Raises:
            RuntimeError: The world was not reset, or `set_state` refuses.
            ValueError: `set_state` refuses.
        """
        return self.get_state()

    @full_state.setter
    def full_state(self, state: State) -> None:
        self.set_state(state)

    def _check_started(self, what: str) -> None:
        if self._keyframe is None:
            raise RuntimeError(f"reset must be called before {what}")

    def _checked(self, action: Action) -> NDArray[np.float32]:
        checked = np.asarray(action, np.float32)
        if checked.shape != (3,):
            raise ValueError(f"an action must have shape (3,), got {checked.shape}")
        for name, value, low, high in zip(
            layout.ACTION_NAMES, checked, layout.ACTION_LOW, layout.ACTION_HIGH, strict=True
        ):
            if not low <= value <= high:  # NaN compares false too
                raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {value}")
        return checked

    def _command(self, action: NDArray[np.float32], zone: int) -> Command:
        left, right = action[:2] + self.np_random.normal(0.0, self._actuator_noise, 2)
        if zone != layout.ZONE_RANDOM:
            return Command(float(left), float(right), jump=zone == layout.ZONE_JUMP)
        speed = self.np_random.uniform(*self.room.kick_speed)
        direction = self.np_random.uniform(-np.pi, np.pi)
        kick = speed * np.array([np.cos(direction), np.sin(direction)])
        return Command(float(left), float(right), float(kick[0]), float(kick[1]))

    def _clear_film(self) -> None:
        self._film = None if self._film is None else []

    def _decide(self, command: Command, film: list[Picture] | None = None) -> None:
        self._physics.advance(command, film)
        self._commands.append(command)
        if len(self._commands) == self._keyframe_every:
            self._seat_keyframe(self._physics.read())

    def _seat_keyframe(self, state: Vector) -> None:
        self._physics.seat(state)
        self._keyframe = state
        self._commands = []

    def _sense(self) -> Observation:
        reading = self._physics.sense()
        distances = np.append(reading.walls, reading.toy_distance)
        noise = self.np_random.normal(0.0, self._sensor_noise, len(distances) + 1)
        values = distances + noise[:-1]
        if self._toy_direction:
            bearing = reading.toy_bearing + layout.DIRECTION_NOISE * noise[-1]
            there = reading.toy_distance > 0
            values = np.append(values, (there * np.cos(bearing), there * np.sin(bearing)))
        box = self.observation_space
        assert isinstance(box, gym.spaces.Box)  # noqa: S101 - tells the type checker
        return np.clip(values.astype(np.float32), box.low, box.high)

    def _check_reached(self, expected: Vector) -> None:
        reached = self._physics.read()
        if reached.tobytes() != expected.tobytes():
            self._keyframe = None
            raise RuntimeError(
                "the physical state reached must be exactly the one saved, "
                f"got a difference of {np.abs(reached - expected).max():g}"
            )


def _check_render_mode(render_mode: str | None) -> None:
    modes = (None, *ToyRoom.metadata["render_modes"])
    if render_mode not in modes:
        raise ValueError(f"render_mode must be one of {modes}, got {render_mode!r}")
    # Without a display pybullet would end the whole process.
    if render_mode == "human" and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise RuntimeError("render_mode 'human' needs a display, got no DISPLAY variable")
