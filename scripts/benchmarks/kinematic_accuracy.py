"""How close is the toy room of batched arithmetic to pybullet's, and how fast is it?

    python -m scripts.benchmarks.kinematic_accuracy

lets a robot take random decisions in pybullet, lets the kinematic robot take each of them
from the same pose, without noise, and prints how far apart they end, away from the walls (where
neither at the start nor at the end a wall is within a centimetre of the chassis) and near them;
then how far apart the places are where kicked toys land; then how many decisions a second the
worlds take together with default noise and sensors.
"""

import math
import time
from dataclasses import dataclass, field

import numpy as np
import torch
import tyro
from numpy.typing import NDArray

from torch_iac_envs.kinematic import ToyRoomKinematic, drive, roll
from torch_iac_envs.physics import Command, Physics, resting_state
from torch_iac_envs.room import TOY_ROLL, Room

Array = NDArray[np.float64]

ROOM = Room()
CLEAR = 0.01  # m between chassis and walls away from the walls


@dataclass(frozen=True)
class Study:
    """What is compared."""

    decisions: int = 10_000
    """How many random decisions are taken, and how many toys are kicked."""
    seed: int = 0
    """Draws the decisions."""
    worlds: list[int] = field(default_factory=lambda: [1, 256, 4_096])
    """How many worlds are stepped together when the speed is measured."""
    repeats: int = 50
    """How often they are stepped; the median is printed."""
    device: str = "cpu"
    """Where the speed is measured."""


@dataclass(frozen=True)
class Difference:
    """How far apart the two robots end, on average over some of the decisions.

    Attributes:
        share: Those decisions' share of all.
        displacement: Distance between their ends, as a share of the distance covered.
        heading: Angle between their headings (rad).
    """

    share: float
    displacement: float
    heading: float


@dataclass(frozen=True)
class Comparison:
    """The differences away from the walls, near them, and everywhere."""

    away: Difference
    near: Difference
    everywhere: Difference


def compare(n_decisions: int, seed: int) -> Comparison:
    """Return how far the kinematic robot ends from pybullet's in random decisions."""
    wheels = np.random.default_rng(seed).uniform(-1, 1, (n_decisions, 2))
    starts, ends = _physical_poses(wheels)
    start, speeds = torch.tensor(starts.T).float(), torch.tensor(wheels.T).float()
    position, heading = drive(ROOM, start[:2], start[2], speeds)
    apart = np.linalg.norm(position.numpy().T - ends[:, :2], axis=1)
    covered = np.linalg.norm(ends[:, :2] - starts[:, :2], axis=1)
    turned = np.abs(np.angle(np.exp(1j * (heading.numpy() - ends[:, 2]))))
    away = np.minimum(_clearance(starts), _clearance(ends)) > CLEAR
    return Comparison(
        *(
            Difference(
                share=float(some.mean()),
                displacement=float(apart[some].mean() / covered[some].mean()),
                heading=float(turned[some].mean()),
            )
            for some in (away, ~away, np.ones_like(away))
        )
    )


def landings(n_decisions: int, seed: int) -> tuple[Array, Array]:
    """Return where kicked toys land, kinematic and pybullet's, each of shape `(decisions, 2)`."""
    draw = np.random.default_rng(seed)
    reach, (slowest, fastest) = ROOM.toy_reach, ROOM.kick_speed
    starts = draw.uniform(-reach, reach, (n_decisions, 2))
    angles = draw.uniform(-math.pi, math.pi, n_decisions)
    speeds = draw.uniform(slowest, fastest, (n_decisions, 1))
    kicks = speeds * np.stack([np.cos(angles), np.sin(angles)], 1)
    place, kick = torch.tensor(starts), torch.tensor(kicks)
    place = roll(place, kick, ROOM.drive_seconds, reach)
    place = roll(place, kick * TOY_ROLL, ROOM.brake_seconds, reach)
    return place.numpy(), _physical_landings(starts, kicks)


def _physical_poses(wheels: Array) -> tuple[Array, Array]:
    """Return x, y and heading before and after each decision, each of shape `(decisions, 3)`."""
    physics, poses = Physics(ROOM, 0, substeps=8), np.zeros((len(wheels) + 1, 3))
    for row, (left, right) in enumerate(wheels):
        x, y, heading = poses[row]
        physics.seat(resting_state(ROOM, (x, y), heading, (0.0, 0.0)))
        physics.advance(Command(left, right))
        poses[row + 1] = physics.robot_pose()
    physics.close()
    return poses[:-1], poses[1:]


def _physical_landings(starts: Array, kicks: Array) -> Array:
    physics, ends = Physics(ROOM, 0, substeps=8), np.empty_like(starts)
    for row, (start, kick) in enumerate(zip(starts, kicks, strict=True)):
        physics.seat(resting_state(ROOM, (0.0, 0.0), 0.0, tuple(start)))
        physics.advance(Command(0.0, 0.0, *kick))
        ends[row] = physics.read()[17:19]
    physics.close()
    return ends


def _clearance(poses: Array) -> Array:
    """Return how far the chassis is from the nearest wall, shape `(decisions,)`."""
    extent = ROOM.chassis / 2 * (np.abs(np.cos(poses[:, 2])) + np.abs(np.sin(poses[:, 2])))
    clearance: Array = ROOM.side / 2 - np.abs(poses[:, :2]).max(axis=1) - extent
    return clearance


def decisions_per_second(n_worlds: int, repeats: int, device: str) -> float:
    """Return how many decisions `n_worlds` worlds take together in a second."""
    env = ToyRoomKinematic(n_worlds, device=device)
    env.reset(seed=0)
    low, high = (torch.tensor(bound, device=device) for bound in ((-1.0, -1.0, 0.0), (1.0,) * 3))
    actions = low + (high - low) * torch.rand(n_worlds, 3, device=device)
    seconds = [_time(env, actions) for _ in range(repeats + 5)][5:]
    return n_worlds / float(np.median(seconds))


def _time(env: ToyRoomKinematic, actions: torch.Tensor) -> float:
    start = time.perf_counter()
    env.step(actions)[0].cpu()
    return time.perf_counter() - start


def main(study: Study) -> None:
    """Print what was found."""
    torch.set_num_threads(1)
    for name, found in vars(compare(study.decisions, study.seed)).items():
        print(
            f"{name}: {found.share:.0%} of the decisions, displacement {found.displacement:.2%} "
            f"apart, heading {found.heading:.4f} rad apart"
        )
    kinematic, physical = landings(study.decisions, study.seed)
    tenths = np.linspace(0.1, 0.9, 9)
    gaps = np.abs(np.quantile(kinematic, tenths, axis=0) - np.quantile(physical, tenths, axis=0))
    print(f"toy: tenths of the landing places at most {gaps.max():.3f} m apart")
    for n_worlds in study.worlds:
        speed = decisions_per_second(n_worlds, study.repeats, study.device)
        print(f"{n_worlds} worlds: {speed:,.0f} decisions a second")


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
