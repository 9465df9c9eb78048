"""The toy room's measures, and the names of its actions and sensors.

Lengths are in metres, times in seconds, angles in radians. Every version of the toy room reads
these numbers, so that their worlds agree.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
"""Shape `(height, width, 3)`: red, green and blue."""

ACTION_NAMES = ("left_wheel", "right_wheel", "sound")
ACTION_LOW = (-1.0, -1.0, 0.0)
ACTION_HIGH = (1.0, 1.0, 1.0)
"""The actions' names and bounds: shares of a wheel's full speed, and a frequency without a unit.

Source: Oudeyer and Kaplan (2004), section 2.2.
"""

F1_END, F2_END = 1 / 3, 2 / 3
"""Zones of the sound: f1 up to and with the first number, f2 up to and with the second, f3 above.

Source: Oudeyer and Kaplan (2004), section 2.2, which leaves gaps: f1 up to 0.33, f2 from 0.34 to
0.66, f3 from 0.67.
"""
ZONE_NAMES = ("f1", "f2", "f3")
"""The paper's names of the zones."""
ZONE_RANDOM, ZONE_STILL, ZONE_JUMP = range(3)
"""The zones' numbers, by what the toy does in them."""

ACCELERATION = 8.0
"""What the motors can give (m/s2): full speed is reached in about 0.1 s."""
TOY_ROLL = 0.1
"""What is left of a kick's speed when the toy brakes."""
DIRECTION_NOISE = 2.0
"""Noise of the toy's direction (rad) for a metre of noise of a distance."""


@dataclass(frozen=True)
class Room:
    """What the room, its robot and its toy measure.

    Attributes:
        side: Inner side of the square room, from wall to wall (m).
        wall_height: Height of the walls (m).
        chassis: Side of the robot's square chassis, which bumps into walls (m).
        track: Distance between the two wheels (m).
        wheel_radius: Radius of a wheel (m).
        full_speed: Speed of a wheel's rim at the wheel command 1 (m/s).
        drive_seconds: First part of a decision, in which the wheels are driven (s).
        brake_seconds: Last part of a decision, in which they brake to rest (s).
        toy_radius: Radius of the toy, a ball (m).
        kick_speed: Least and greatest speed of the toy when it moves at random (m/s).
        beam_height: Height at which the infra-red beams leave the robot, above the toy (m).

    Source: the numbers are this library's; the papers give none.
    """

    side: float = 1.4
    wall_height: float = 0.25
    chassis: float = 0.26
    track: float = 0.24
    wheel_radius: float = 0.04
    full_speed: float = 0.9
    drive_seconds: float = 0.4
    brake_seconds: float = 0.1
    toy_radius: float = 0.06
    kick_speed: tuple[float, float] = (6.0, 12.0)
    beam_height: float = 0.16

    @property
    def decision_seconds(self) -> float:
        """How long one decision lasts (s)."""
        return self.drive_seconds + self.brake_seconds

    @property
    def diagonal(self) -> float:
        """The longest distance there is in the room (m)."""
        return self.side * 2**0.5

    @property
    def robot_reach(self) -> float:
        """Largest coordinate (m) at which the robot's centre is clear of walls, however turned."""
        return (self.side - self.chassis * 2**0.5) / 2

    @property
    def toy_reach(self) -> float:
        """Largest coordinate (m) at which the toy's centre is clear of the walls."""
        return self.side / 2 - self.toy_radius


def zone_ends(f1_end: float, f2_end: float) -> tuple[float, float]:
    """Return where f1 and f2 end, as float32 has it, so that an end is in the lower zone.

    Raises:
        ValueError: They lie outside [0, 1], or the first above the second.
    """
    _check_kind("f1_end", f1_end)
    _check_kind("f2_end", f2_end)
    if not 0 <= f1_end <= f2_end <= 1:
        raise ValueError(f"f1_end and f2_end must go up within [0, 1], got {f1_end} and {f2_end}")
    return float(np.float32(f1_end)), float(np.float32(f2_end))


def sensor_names(n_beams: int, toy_direction: bool) -> tuple[str, ...]:
    """Return the sensors' names, in the order in which they are read."""
    walls = tuple(f"wall_{beam}" for beam in range(n_beams))
    return (*walls, "toy_distance", *(("toy_cos", "toy_sin") if toy_direction else ()))


def sensor_units(n_beams: int, toy_direction: bool) -> tuple[str, ...]:
    """Return the sensors' units, in the order in which they are read; "" for those without."""
    return (*("m",) * (n_beams + 1), *(("", "") if toy_direction else ()))


def sensor_bounds(
    room: Room, n_beams: int, toy_direction: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the least and the greatest reading of each sensor, each of shape `(sensors,)`.

    Distances are in metres; the toy's direction is a cosine and a sine.
    """
    directions = 2 if toy_direction else 0
    low = [0.0] * (n_beams + 1) + [-1.0] * directions
    high = [room.diagonal] * (n_beams + 1) + [1.0] * directions
    return np.array(low, np.float32), np.array(high, np.float32)


WHOLE = "num_envs", "beams", "keyframe_every", "substeps", "width", "height"
"""The arguments of a world that are whole numbers."""

RANGES = {
    "num_envs": (1, math.inf),
    "beams": (0, 10_000),
    "sensor_noise": (0, 1000.0),
    "actuator_noise": (0, 1000.0),
    "keyframe_every": (1, math.inf),
    "substeps": (1, 1000),
    "width": (1, 4096),
    "height": (1, 4096),
}
"""Limits of a world's arguments: far beyond any use, and before an engine fails."""


def check_argument(name: str, value: float) -> None:
    """Refuse an argument that is smaller or larger than it may be, or not such a number.

    Raises:
        ValueError: `value` is outside what `RANGES` has under `name`, infinite, NaN, no number at
            all, or not whole where it must be.
    """
    least, most = RANGES[name]
    _check_kind(name, value)
    if not least <= value < math.inf:
        raise ValueError(f"{name} must be at least {least} and finite, got {value}")
    if value > most:
        raise ValueError(f"{name} must be at most {most}, got {value}")


def _check_kind(name: str, value: object) -> None:
    whole = (int, np.integer)
    kind = whole if name in WHOLE else (*whole, float, np.floating)
    if isinstance(value, bool) or not isinstance(value, kind):
        what = "a whole number" if name in WHOLE else "a number"
        raise ValueError(f"{name} must be {what}, got {value!r:.80}")
