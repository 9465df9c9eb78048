"""The toy room's physics by pybullet: moving, sensing, drawing, and exact states."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torch_iac_envs.bodies import SLICE, build, motor_torque
from torch_iac_envs.bullet import pybullet as p
from torch_iac_envs.room import TOY_ROLL, Picture, Room

STATE_DIM = 30
"""Robot's pose 7 and velocity 6, two wheels' angle and speed 4, toy's pose 7 and velocity 6."""

EYE, TARGET, FIELD_OF_VIEW = (0.0, -1.5, 2.1), (0.0, -0.08, 0.0), 50.0
"""Where the camera is and looks, in halves of the room's side; how high a view it has (degrees)."""

Vector = NDArray[np.float64]
"""Numbers in a row, or one row a decision."""
Point = tuple[float, float, float]
"""Its x, y and z (m)."""


@dataclass(frozen=True)
class Command:
    """The command of one decision, noise included; the engine's only input.

    Attributes:
        left: Left wheel's speed, as a share of full speed.
        right: Right wheel's speed, as a share of full speed.
        kick_x: The velocity along x that the toy is given (m/s); without a kick it stops.
        kick_y: The velocity along y that the toy is given (m/s).
        jump: Whether the toy ends in the robot.
    """

    left: float
    right: float
    kick_x: float = 0.0
    kick_y: float = 0.0
    jump: bool = False


@dataclass(frozen=True)
class Reading:
    """What the sensors would read without noise.

    Attributes:
        walls: Distance to the wall along each beam, shape `(n_beams,)` (m).
        toy_distance: Distance from the robot's centre to the toy's surface (m), 0 inside it.
        toy_bearing: Direction of the toy in the robot's frame (rad).
    """

    walls: Vector
    toy_distance: float
    toy_bearing: float


def resting_state(
    room: Room, robot: tuple[float, float], heading: float, toy: tuple[float, float]
) -> Vector:
    """Return the state, shape `(30,)`, in which robot and toy stand still where told.

    Args:
        room: The room's measures.
        robot: Coordinates of the robot's centre; the room's centre is the origin (m).
        heading: Direction in which the robot faces, anticlockwise from the x axis (rad).
        toy: Coordinates of the toy's centre (m).
    """
    state = np.zeros(STATE_DIM)
    state[:3] = (*robot, room.wheel_radius)
    state[3:7] = _turn(heading)
    state[17:20] = (*toy, room.toy_radius)
    state[20:24] = _turn(0.0)
    return state


class Physics:
    """One pybullet client that holds one toy room.

    What happens is a function of the state last seated and of the commands since. All but `seat`
    and `close` needs a state that was seated.

    Args:
        room: The room's measures.
        n_beams: Number of infra-red beams.
        substeps: Physics steps in a tenth of a second.
        window: Whether to open a window and run in real time.
        picture_size: Width and height of its pictures (pixels).

    Attributes:
        is_open: Whether it has its client still.

    Raises:
        RuntimeError: The engine gave no client.
    """

    def __init__(
        self,
        room: Room,
        n_beams: int,
        substeps: int,
        window: bool = False,
        picture_size: tuple[int, int] = (480, 360),
    ) -> None:
        client = p.connect(p.GUI if window else p.DIRECT)
        if client < 0:
            raise RuntimeError(f"pybullet's client must be at least 0, got {client}")
        self._client = {"physicsClientId": client}
        self._arguments = (room, n_beams, substeps, window, picture_size)
        self.is_open = True
        self._room = room
        self._substeps = substeps
        self._window = window
        self._picture_size = picture_size
        self._beams = np.arange(n_beams) * (2 * math.pi / max(n_beams, 1))
        if window:
            self._arrange_window()

    def __getstate__(self) -> tuple[Any, ...]:
        """Return what makes another client alike, for copies and pickles; it has no bodies yet.

        Raises:
            TypeError: It has a window, of which the engine opens one a process.
        """
        if self._window:
            raise TypeError("a room with a window (render_mode 'human') must not be copied")
        return self._arguments, self.is_open

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        arguments, is_open = state
        self.__init__(*arguments)  # type: ignore[misc]  # a client of its own
        if not is_open:
            self.close()

    def close(self) -> None:
        """Disconnect the client, once."""
        if self.is_open:
            p.disconnect(**self._client)
        self.is_open = False

    def seat(self, state: Vector) -> None:
        """Build the room anew and put its bodies as `state`, shape `(30,)`, says.

        For robot and then toy it is position (m), quaternion, velocity (m/s) and spin (rad/s);
        between them angle (rad) and speed (rad/s) of the left and the right wheel.
        """
        self._show(False)
        self._robot, self._toy = build(self._client, self._room, self._substeps)
        self._seat_body(self._robot, state[:13])
        for joint, (angle, speed) in enumerate(state[13:17].reshape(2, 2)):
            p.resetJointState(self._robot, joint, angle, speed, **self._client)
        self._seat_body(self._toy, state[17:])
        self._show(True)

    def read(self) -> Vector:
        """Return the state, shape `(30,)`, as `seat` takes it."""
        wheels = p.getJointStates(self._robot, [0, 1], **self._client)
        spins = [value for wheel in wheels for value in wheel[:2]]
        return np.array([*self._read_body(self._robot), *spins, *self._read_body(self._toy)])

    def robot_pose(self) -> tuple[float, float, float]:
        """Return where the robot's centre is, x and y (m), and its heading (rad)."""
        (x, y, _), (i, j, k, w) = p.getBasePositionAndOrientation(self._robot, **self._client)
        return x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    def advance(self, command: Command, film: list[Picture] | None = None) -> None:
        """Simulate one decision; at its end the robot stands and the toy almost stands.

        Args:
            command: What happens.
            film: Gets a picture, shape `(height, width, 3)`, at the end of every tenth of a second;
                looking changes nothing.
        """
        self._roll_toy(command.kick_x, command.kick_y)
        self._run_wheels(command.left, command.right)
        self._run(self._room.drive_seconds, film)
        self._roll_toy(command.kick_x * TOY_ROLL, command.kick_y * TOY_ROLL)
        self._run_wheels(0.0, 0.0)
        self._run(self._room.brake_seconds, film)
        if command.jump:
            self._jump()
            if film:
                film[-1] = self.picture()

    def sense(self) -> Reading:
        """Return what the sensors would read without noise, in one batch of rays."""
        x, y, heading = self.robot_pose()
        toy_x, toy_y, _ = self._toy_position()
        gap = math.hypot(toy_x - x, toy_y - y)
        inside = gap <= self._room.toy_radius
        ends = self._beam_ends(x, y, heading)
        starts = [(x, y, self._room.beam_height)] * len(ends)
        if not inside:
            starts.append((x, y, self._room.toy_radius))
            ends.append((toy_x, toy_y, self._room.toy_radius))
        hits = self._cast(starts, ends)
        return Reading(
            walls=hits[: len(self._beams)] * self._room.diagonal,
            toy_distance=0.0 if inside else float(hits[-1]) * gap,
            toy_bearing=math.atan2(toy_y - y, toy_x - x) - heading,
        )

    def picture(self) -> Picture:
        """Return a picture of the room from above at an angle, shape `(height, width, 3)`."""
        width, height = self._picture_size
        half = self._room.side / 2
        eye, target = ([half * number for number in point] for point in (EYE, TARGET))
        view = p.computeViewMatrix(eye, target, (0, 0, 1))
        lens = p.computeProjectionMatrixFOV(FIELD_OF_VIEW, width / height, 0.1, 20.0)
        image = p.getCameraImage(
            width,
            height,
            view,
            lens,
            lightDirection=(1.5, -2.0, 4.0),
            renderer=p.ER_TINY_RENDERER,
            **self._client,
        )
        pixels = np.asarray(image[2], np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(pixels[:, :, :3])

    # The window.

    def _arrange_window(self) -> None:
        p.configureDebugVisualizer(p.COV_ENABLE_GUI, 0, **self._client)
        p.configureDebugVisualizer(p.COV_ENABLE_SHADOWS, 0, **self._client)
        p.resetDebugVisualizerCamera(0.95 * self._room.side, 0, -55, (0, -0.08, 0), **self._client)

    def _show(self, on: bool) -> None:
        """Turn the window's drawing on, or off while the room is rebuilt."""
        if self._window:
            p.configureDebugVisualizer(p.COV_ENABLE_RENDERING, int(on), **self._client)

    # Acting on the bodies.

    def _roll_toy(self, x: float, y: float) -> None:
        p.resetBaseVelocity(self._toy, (x, y, 0.0), (0.0, 0.0, 0.0), **self._client)

    def _run_wheels(self, left: float, right: float) -> None:
        scale = self._room.full_speed / self._room.wheel_radius
        # The engine takes a motor's torque for a whole call, not for one of its substeps.
        torque = motor_torque(self._room) / self._substeps
        p.setJointMotorControlArray(
            self._robot,
            (0, 1),
            p.VELOCITY_CONTROL,
            targetVelocities=(left * scale, right * scale),
            forces=(torque, torque),
            **self._client,
        )

    def _run(self, seconds: float, film: list[Picture] | None) -> None:
        for _ in range(round(seconds / SLICE)):
            p.stepSimulation(**self._client)
            if film is not None:
                film.append(self.picture())
            if self._window:
                time.sleep(SLICE)

    def _jump(self) -> None:
        x, y, _ = self.robot_pose()
        place = (x, y, self._room.toy_radius)
        p.resetBasePositionAndOrientation(self._toy, place, _turn(0.0), **self._client)
        self._roll_toy(0.0, 0.0)

    # Reading the bodies.

    def _toy_position(self) -> Point:
        position: Point = p.getBasePositionAndOrientation(self._toy, **self._client)[0]
        return position

    def _beam_ends(self, x: float, y: float, heading: float) -> list[Point]:
        length, height = self._room.diagonal, self._room.beam_height
        across = (x + length * np.cos(heading + self._beams)).tolist()
        along = (y + length * np.sin(heading + self._beams)).tolist()
        return [(u, v, height) for u, v in zip(across, along, strict=True)]

    def _cast(self, starts: list[Point], ends: list[Point]) -> Vector:
        """Return how far along each ray, as a share of its length, it meets a wall or the toy."""
        if not starts:
            return np.empty(0)
        hits = p.rayTestBatch(starts, ends, **self._client)
        return np.array([hit[2] for hit in hits])

    def _read_body(self, body: int) -> list[float]:
        position, turn = p.getBasePositionAndOrientation(body, **self._client)
        velocity, spin = p.getBaseVelocity(body, **self._client)
        return [*position, *turn, *velocity, *spin]

    def _seat_body(self, body: int, state: Vector) -> None:
        position, turn, velocity, spin = np.split(state, (3, 7, 10))
        p.resetBasePositionAndOrientation(body, position, turn, **self._client)
        p.resetBaseVelocity(body, velocity, spin, **self._client)


def _turn(heading: float) -> tuple[float, float, float, float]:
    """Return the quaternion of a turn about the vertical."""
    return 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)
