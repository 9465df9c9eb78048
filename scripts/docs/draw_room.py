"""Draw the toy room and what its robot senses: figure 1 of the paper.

    python -m scripts.docs.draw_room

writes `docs/images/room.png`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.axes import Axes
from numpy.typing import NDArray

from torch_iac_envs.physics import (
    EYE,
    FIELD_OF_VIEW,
    TARGET,
    Physics,
    Reading,
    resting_state,
)
from torch_iac_envs.room import Room

Array = NDArray[np.float64]

WIDTH, HEIGHT = 1920, 1440  # pixels, before the picture is made smaller and so smoother
BEAMS = 8
PAPER = {"facecolor": "#cec2b1", "edgecolor": "none", "pad": 2}  # behind a label; as the floor


@dataclass(frozen=True)
class Study:
    """Where everything is."""

    out: Path = Path("docs/images/room.png")
    """Where the picture goes."""
    robot: tuple[float, float] = (-0.30, -0.22)
    """Where the robot is (m)."""
    heading: float = 0.5
    """Where it faces (rad)."""
    toy: tuple[float, float] = (0.62, -0.1)
    """Where the toy is (m)."""


def project(points: Array, room: Room) -> Array:
    """Return where points, shape `(n, 3)`, appear in the picture, shape `(n, 2)` (pixels)."""
    half = room.side / 2
    eye, target = half * np.array(EYE), half * np.array(TARGET)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0, 0, 1))
    right = right / np.linalg.norm(right)
    across, up, depth = np.stack([right, np.cross(right, forward), forward]) @ (points - eye).T
    focus = HEIGHT / 2 / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    return np.stack([WIDTH / 2 + focus * across / depth, HEIGHT / 2 - focus * up / depth], 1)


def draw(study: Study) -> None:
    """Write the picture."""
    room = Room()
    physics = Physics(room, BEAMS, substeps=8, picture_size=(WIDTH, HEIGHT))
    physics.seat(resting_state(room, study.robot, study.heading, study.toy))
    figure = plt.figure(figsize=(9.6, 7.2))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(physics.picture(), interpolation="antialiased")
    _draw_sensing(axes, study, room, physics.sense())
    axes.set(xlim=(0, WIDTH), ylim=(0.95 * HEIGHT, 0.08 * HEIGHT))
    axes.axis("off")
    study.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(study.out, dpi=100, bbox_inches="tight", pad_inches=0)
    physics.close()


def _draw_sensing(axes: Axes, study: Study, room: Room, reading: Reading) -> None:
    start = np.array([*study.robot, room.beam_height])
    for beam, length in enumerate(reading.walls):
        end = start + length * _direction(study.heading + beam * 2 * np.pi / BEAMS)
        _draw_line(axes, np.stack([start, end]), room, color="#b5462f", lw=1.2, ls=(0, (2, 3)))
        _label(axes, f"wall_{beam}", start + 0.6 * (end - start), room)
    low = np.array([*study.robot, room.toy_radius])
    toy = low + reading.toy_distance * _direction(study.heading + reading.toy_bearing)
    _draw_line(axes, np.stack([low, toy]), room, color="#1f3f77", lw=2.2)
    _label(axes, "toy_distance", low + 0.55 * (toy - low), room, color="#1f3f77")


def _direction(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def _draw_line(axes: Axes, points: Array, room: Room, **style: Any) -> None:
    axes.plot(*project(points, room).T, solid_capstyle="round", **style)


def _label(axes: Axes, text: str, place: Array, room: Room, color: str = "#7a2c1c") -> None:
    (x, y), *_ = project(place[None], room)
    axes.text(x, y, text, color=color, bbox=PAPER, fontsize=11, ha="center", va="center")


if __name__ == "__main__":
    draw(tyro.cli(Study, description=__doc__))
