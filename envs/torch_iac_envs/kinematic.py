"""`ToyRoomKinematic`, the toy room for thousands of robots at once, on any torch device.

Shapes: `A` worlds, `W` the two wheels or the two coordinates x and y, `N` slices of a decision.
Numbers of one kind lie side by side, worlds last.

A world's results are the same to the last bit however many others there are, however many threads
work, and on every processor: the room uses only operations of which IEEE 754 says what they give,
and adds up more than two numbers one after the other. `elementary` has what goes beyond them.
"""

import math
from collections.abc import Sequence
from copy import deepcopy
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from torch_iac_envs import room as layout
from torch_iac_envs.elementary import circle, root
from torch_iac_envs.randomness import normal, pack_seeds, uniform
from torch_iac_envs.room import Picture, Room, check_argument

if TYPE_CHECKING:
    from torch_iac_envs.physics import Physics

SLICE = 0.025
"""How much time the robot's motion advances at once (s); a decision is a whole number of them."""
WALL_FRICTION = 0.1
"""Of the chassis on a wall."""
TOY_BOUNCE = 0.65
"""What a wall leaves of the toy's speed towards it. Less than the engine is told (0.9), because it
loses speed when it keeps a fast toy from tunnelling; of 0.4 to 1, this comes nearest to where the
engine's toys land."""
N_BOUNCES = 32
"""Bounces after which a toy is at rest: it has a millionth of its speed."""

State = dict[str, Tensor]
"""What `get_state` returns; it says the shapes."""


class ToyRoomKinematic(gym.vector.VectorEnv[Tensor, Tensor | NDArray[Any], Tensor]):
    """The toy room of `ToyRoom` as batched arithmetic: `num_envs` worlds in one step.

    Actions, sensors, their names and bounds, noise and the toy's rules are those of `ToyRoom`.
    Instead of a physics engine there are a robot whose wheels do not slip, with motors and walls
    that push as hard as there, and a toy whose bounces are solved in closed form. Observations,
    rewards and `info["zone"]` are tensors on `device`; actions may be tensors or arrays.

    A world's random numbers depend on its own seed and on how often it was stepped or reset since
    it was seeded, and on nothing else: world i of many equals world i alone.

    Args:
        num_envs: Number of worlds.
        render_mode: None, or `"rgb_array"` for a picture of each world.
        width: Width of the pictures (pixels).
        height: Height of the pictures (pixels).
        beams: Number of infra-red beams to the walls.
        toy_direction: Whether the toy's direction is sensed.
        sensor_noise: Standard deviation of each distance (m); the toy's direction gets twice this
            number in radians.
        actuator_noise: Standard deviation of each wheel's speed, as a share of full speed.
        f1_end: The highest sound of f1, in [0, 1].
        f2_end: The highest sound of f2, in [`f1_end`, 1]; above it is f3.
        device: Where the worlds are.
        check_actions: Whether to check that actions are within their bounds. On a GPU the check
            waits for all that was computed before.

    Attributes:
        room: The room's measures, a `Room`.
        device: Where the worlds are.
        metadata: As that of `ToyRoom`; `"autoreset_mode"` says that no episode ends.

    Raises:
        ValueError: An argument is outside its range.

    Source: Oudeyer and Kaplan (2004), section 2.2, as `ToyRoom`; the arithmetic is this library's.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - the type that VectorEnv declares
        "render_modes": ["rgb_array"],
        "render_fps": 2,
        "autoreset_mode": gym.vector.AutoresetMode.DISABLED,
    }
    room: ClassVar[Room] = Room()

    def __init__(
        self,
        num_envs: int = 1,
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
        device: str | torch.device = "cpu",
        check_actions: bool = True,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be None or 'rgb_array', got {render_mode!r}")
        check_argument("num_envs", num_envs)
        check_argument("width", width)
        check_argument("height", height)
        check_argument("beams", beams)
        check_argument("sensor_noise", sensor_noise)
        check_argument("actuator_noise", actuator_noise)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self._picture_size = (width, height)
        self._camera: Physics | None = None
        self.device = torch.device(device)
        self._toy_direction = toy_direction
        self._sensor_noise = sensor_noise
        self._actuator_noise = actuator_noise
        self._zone_ends = layout.zone_ends(f1_end, f2_end)
        self._check_actions = check_actions
        beam_turns = torch.arange(beams, device=self.device) / max(beams, 1)
        self._beams = circle(math.tau * beam_turns.double()).float()[..., None]  # (W, beams, 1)
        self._beams_aside = _aside(self._beams)
        self._declare_spaces(beams)
        self._seeds: Tensor | None = None
        self._moment = 0

    def _declare_spaces(self, beams: int) -> None:
        low, high = layout.sensor_bounds(self.room, beams, self._toy_direction)
        self.single_observation_space = gym.spaces.Box(low, high, dtype=np.float32)
        low_action, high_action = (
            np.array(bound, np.float32) for bound in (layout.ACTION_LOW, layout.ACTION_HIGH)
        )
        self.single_action_space = gym.spaces.Box(low_action, high_action, dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._sensor_bounds = [torch.tensor(b, device=self.device)[:, None] for b in (low, high)]
        self._action_bounds = [
            torch.tensor(bound, device=self.device) for bound in (low_action, high_action)
        ]
        self.metadata = {
            **type(self).metadata,
            "action_names": layout.ACTION_NAMES,
            "sensor_names": layout.sensor_names(beams, self._toy_direction),
            "sensor_units": layout.sensor_units(beams, self._toy_direction),
            "zone_names": layout.ZONE_NAMES,
        }

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Tensor, dict[str, Any]]:
        """Place every robot and toy at random in its room and return what the robots sense.

        Args:
            seed: One for each world, or that of the first world, from which the others count up.
                Without it each world's random numbers go on; the first time they start anywhere.
            options: Not used.

        Returns:
            What is sensed, shape `(A, sensors)`, distances in metres; and nothing.

        Raises:
            ValueError: There are not as many seeds as worlds.
        """
        del options
        if seed is not None or self._seeds is None:
            self._seeds, self._moment = self._checked_seeds(seed), 0
        places, uniforms = self._draw(5, 2 * self._n_noise_pairs)
        places = 2 * places - 1
        self._position = places[:2] * self.room.robot_reach  # (W, A)
        self._toy = places[2:4] * self.room.toy_reach  # (W, A)
        self._heading = places[4] * math.pi  # (A,)
        return self._sense(normal(self._paired(uniforms))), {}

    def step(
        self, actions: Tensor | NDArray[Any]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Take one decision in every world.

        Args:
            actions: Left wheel and right wheel in [-1, 1], sound in [0, 1]; shape `(A, 3)`.

        Returns:
            What is sensed afterwards, shape `(A, sensors)`, distances in metres; and, of shape
            `(A,)`, rewards of 0, False, False and, in `info["zone"]`, the sounds' zones (0, 1, 2).

        Raises:
            RuntimeError: The worlds were not reset.
            ValueError: The actions' shape or their values are not as above.
        """
        self._check_started("step")
        *wheels, sound = self._checked_actions(actions)
        f1_end, f2_end = self._zone_ends
        zone = (sound > f1_end).long() + (sound > f2_end)
        kick, wheel_uniforms, uniforms = self._draw(2, 2, 2 * self._n_noise_pairs)
        noise = normal(torch.cat([self._paired(wheel_uniforms), self._paired(uniforms)], 1))
        speeds = torch.stack(wheels) + self._actuator_noise * noise[:, 0]
        self._position, self._heading = drive(self.room, self._position, self._heading, speeds)
        self._toy = self._move_toy(zone, *kick)
        nothing = torch.zeros(self.num_envs, device=self.device)
        over = torch.zeros(2, self.num_envs, dtype=torch.bool, device=self.device)
        return self._sense(noise[:, 1:]), nothing, over[0], over[1], {"zone": zone}

    def render(self) -> tuple[Picture, ...] | None:
        """Return a picture of each world, shape `(height, width, 3)`, if the mode is so.

        Robots and toys are drawn in the room of `ToyRoom`.

        Raises:
            RuntimeError: The worlds were not reset.
        """
        if self.render_mode is None:
            return None
        self._check_started("render")
        from torch_iac_envs.physics import Physics, resting_state  # slow to import

        if self._camera is None:
            self._camera = Physics(self.room, 0, 1, picture_size=self._picture_size)
        pictures = []
        for (x, y), heading, toy in zip(
            self._position.T.tolist(), self._heading.tolist(), self._toy.T.tolist(), strict=True
        ):
            self._camera.seat(resting_state(self.room, (x, y), heading, tuple(toy)))
            pictures.append(self._camera.picture())
        return tuple(pictures)

    def close_extras(self, **kwargs: Any) -> None:
        """Close the camera's engine."""
        del kwargs
        if self._camera is not None:
            self._camera.close()

    def __copy__(self) -> Self:
        return deepcopy(self)  # a camera closes with its worlds

    def get_state(self) -> State:
        """Return the whole state, as a dict of tensors.

        `robot` holds each robot's x, y (m) and heading (rad), shape `(A, 3)`; `toy` each toy's x
        and y (m), shape `(A, 2)`; `seeds` the worlds' seeds, shape `(A,)`; `moment` how often
        numbers were drawn from them.

        Raises:
            RuntimeError: The worlds were not reset.
        """
        seeds = self._check_started("get_state")
        return {
            "robot": torch.stack([*self._position, self._heading], 1),
            "toy": self._toy.T.clone(memory_format=torch.contiguous_format),
            "seeds": seeds.clone(),
            "moment": torch.tensor(self._moment),
        }

    def set_state(self, state: State) -> None:
        """Go on from what `get_state` returned, exactly; the arguments must be the same as then.

        Raises:
            KeyError: A part of the state is missing.
            ValueError: The state is not that of as many worlds.
        """
        for name, shape in (("robot", (3,)), ("toy", (2,)), ("seeds", ())):
            if state[name].shape != (self.num_envs, *shape):
                raise ValueError(
                    f"{name} must have shape {(self.num_envs, *shape)}, "
                    f"got {tuple(state[name].shape)}"
                )
        robot, self._toy = (
            state[name]
            .to(self.device, torch.float32)
            .T.clone(memory_format=torch.contiguous_format)
            for name in ("robot", "toy")
        )
        self._position, self._heading = robot[:2], robot[2]
        self._seeds = state["seeds"].to(self.device, torch.int64, copy=True)
        self._moment = int(state["moment"])

    def _check_started(self, what: str) -> Tensor:
        if self._seeds is None:
            raise RuntimeError(f"reset must be called before {what}")
        return self._seeds

    def _checked_seeds(self, seed: int | Sequence[int] | None) -> Tensor:
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed must name one for each of {self.num_envs} worlds, got {seeds}")
        return pack_seeds(seeds, self.device)

    def _checked_actions(self, actions: Tensor | NDArray[Any]) -> Tensor:
        """Return the actions, shape `(3, A)`."""
        actions = torch.as_tensor(actions, dtype=torch.float32, device=self.device)
        if actions.shape != (self.num_envs, 3):
            raise ValueError(
                f"actions must have shape {(self.num_envs, 3)}, got {tuple(actions.shape)}"
            )
        low, high = self._action_bounds
        # NaN equals nothing, itself included.
        if self._check_actions and not torch.equal(actions.clamp(low, high), actions):
            _refuse(actions.cpu())
        return actions.T.contiguous()

    @property
    def _n_noise_pairs(self) -> int:
        return (self._beams.shape[1] + 3) // 2  # normal numbers come in pairs

    def _draw(self, *counts: int) -> tuple[Tensor, ...]:
        """Return new uniform numbers, one tensor of shape `(count, A)` for each count."""
        numbers = uniform(self._check_started("drawing"), self._moment, sum(counts))
        self._moment += 1
        return torch.split(numbers, list(counts))

    def _paired(self, numbers: Tensor) -> Tensor:
        """Return the first half of numbers beside the second, shape `(2, pairs, A)`."""
        return numbers.view(2, -1, self.num_envs)

    def _move_toy(self, zone: Tensor, speed: Tensor, direction: Tensor) -> Tensor:
        """Return where the toys end, shape `(W, A)`, once the robots are where they end."""
        slowest, fastest = self.room.kick_speed
        angle = (2 * direction - 1) * math.pi
        kick = (slowest + (fastest - slowest) * speed) * circle(angle)
        reach = self.room.toy_reach
        kicked = roll(self._toy, kick, self.room.drive_seconds, reach)
        kicked = roll(kicked, kick * layout.TOY_ROLL, self.room.brake_seconds, reach)
        toy = torch.where(zone == layout.ZONE_RANDOM, kicked, self._toy)
        return torch.where(zone == layout.ZONE_JUMP, self._position, toy)

    def _sense(self, normals: Tensor) -> Tensor:
        """Return what the robots sense, shape `(A, sensors)`; normal numbers `(2, pairs, A)`."""
        noise = self._sensor_noise * normals.flatten(0, 1)
        n_beams = self._beams.shape[1]
        turn = layout.DIRECTION_NOISE * noise[n_beams + 1] - self._heading
        (cos, sin), (turn_cos, turn_sin) = circle(torch.stack([self._heading, turn])).unbind(1)
        beams = cos * self._beams + sin * self._beams_aside
        walls = wall_distances(self.room, self._position, beams)
        towards = self._toy - self._position
        gap = root(_added(towards * towards))
        distance = (gap - self.room.toy_radius).clamp(min=0)
        readings = [walls + noise[:n_beams], (distance + noise[n_beams])[None]]
        if self._toy_direction:
            # Turned into the robot's frame.
            seen = towards / gap.clamp(min=self.room.toy_radius) * (distance > 0)
            readings.append(turn_cos * seen + turn_sin * _aside(seen))
        low, high = self._sensor_bounds
        return torch.cat(readings).clamp(low, high).T.contiguous()


def drive(room: Room, position: Tensor, heading: Tensor, speeds: Tensor) -> tuple[Tensor, Tensor]:
    """Return where robots are after a decision (m), `(W, A)`, and their headings (rad), `(A,)`.

    The wheels never slip. A motor changes its wheel's speed by `ACCELERATION` at most, a wall
    takes from the wheels what would drive a corner of the chassis into it.

    Args:
        room: The room's measures.
        position: The robots' centres, shape `(W, A)` (m); the room's centre is the origin.
        heading: Anticlockwise from the x axis, shape `(A,)` (rad).
        speeds: Left and right wheel's speed, as a share of full speed, shape `(W, A)`.
    """
    if position.device.type != "cpu":  # not checked on a GPU, which would have to wait
        return _drive_among_walls(room, position, heading, speeds)
    end, end_heading, touches = _drive_freely(room, position, heading, speeds)
    near = touches.nonzero()[:, 0]
    if len(near) > 0:
        end[:, near], end_heading[near] = _drive_among_walls(
            room, position[:, near], heading[near], speeds[:, near]
        )
    return end, end_heading


def _drive_freely(
    room: Room, position: Tensor, heading: Tensor, speeds: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the result of `drive` without walls, and which robots would touch one, shape `(A,)`.

    All slices are computed at once.
    """
    n_slices, n_driven = _n_slices(room)
    number = torch.arange(1, n_slices + 1, device=speeds.device)[:, None]
    gain = layout.ACCELERATION * SLICE**2
    up = number.clamp(max=n_driven) * gain
    down = (number - n_driven).clamp(min=0) * gain
    driven = (speeds * (room.full_speed * SLICE))[:, None]  # (W, 1, A)
    driven = driven.clamp(-up, up)
    half_turn, _, roll = _arc(room, driven - driven.clamp(-down, down))  # (N, A)
    headings = torch.cat([heading[None], heading + (2 * half_turn).cumsum(0)])
    facing = circle(headings)  # (W, N + 1, A)
    steps = roll * (facing[:, :-1] + facing[:, 1:])
    places = position[:, None] + steps.cumsum(1)
    touches = (places.abs() > _limit(room, facing[:, 1:])).flatten(0, 1).any(0)
    return places[:, -1].clone(), headings[-1].clone(), touches


class _Pose(NamedTuple):
    """Where robots are, shape `(W, A)` (m), and face: cosine and sine, shape `(W, A)`.

    And half the angle by which they turned in this decision (rad), shape `(A,)`.
    """

    position: Tensor
    facing: Tensor
    half_turned: Tensor


def _drive_among_walls(
    room: Room, position: Tensor, heading: Tensor, speeds: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the result of `drive`, computed slice by slice."""
    n_slices, n_driven = _n_slices(room)
    driven = speeds * (room.full_speed * SLICE)
    gain = layout.ACCELERATION * SLICE**2
    pose = _Pose(position, circle(heading), torch.zeros_like(heading))
    wanted, travel = driven, torch.zeros_like(driven)  # of each wheel in one slice
    for number in range(n_slices):
        if number == n_driven:
            wanted = torch.zeros_like(driven)
        travel = wanted.clamp(travel - gain, travel + gain)
        aside = _aside(pose.facing)
        there = _rolled(room, pose, aside, travel)
        depth = _depth(room, there)
        if depth.device.type != "cpu" or depth.any():
            travel = travel - _pushed_back(room, there, depth, travel)
            there = _rolled(room, pose, aside, travel)
            limit = _limit(room, there.facing)
            there = there._replace(position=there.position.clamp(-limit, limit))
        pose = there
    return pose.position, heading + 2 * pose.half_turned


def _n_slices(room: Room) -> tuple[int, int]:
    """Return into how many slices a decision is cut, and in how many the wheels are driven."""
    return round(room.decision_seconds / SLICE), round(room.drive_seconds / SLICE)


def _arc(room: Room, travel: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return what wheels that roll by `travel`, shape `(W, ...)`, do to a robot, each `(...)`.

    Half the angle by which it turns (rad), its tangent, and a quarter of what the wheels roll
    together (m), times the ratio of tangent to angle.
    """
    left, right = travel.unbind()
    half_turn = (right - left) / (2 * room.track)
    square = half_turn * half_turn
    ratio = 1 + square * (1 / 3 + square * (2 / 15))  # Taylor's series; at most 0.34 rad
    return half_turn, half_turn * ratio, (left + right) * 0.25 * ratio


def _rolled(room: Room, pose: _Pose, aside: Tensor, travel: Tensor) -> _Pose:
    """Return where robots are and face after the wheels rolled by `travel`, shape `(W, A)`.

    The rotation is written with the tangent of half its angle, so that it changes no length, and
    the chord of the arc with the sum of the facings before and after.
    """
    half_turn, tangent, roll = _arc(room, travel)
    facings = (pose.facing + tangent * aside) / (0.5 + 0.5 * tangent * tangent)
    return _Pose(
        pose.position + roll * facings, facings - pose.facing, pose.half_turned + half_turn
    )


def _aside(direction: Tensor) -> Tensor:
    """Return directions turned by a quarter, anticlockwise, shape `(W, ...)`."""
    x, y = direction.unbind()
    return torch.stack([-y, x])


def _added(pair: Tensor) -> Tensor:
    """Return the sum of two numbers, shape `(2, ...)`."""
    first, second = pair.unbind()
    return first + second


def _limit(room: Room, facing: Tensor) -> Tensor:
    """Return how far from the room's middle a chassis fits (m), for facings `(W, ...)`."""
    return room.side / 2 - room.chassis / 2 * _added(facing.abs())


def _depth(room: Room, pose: _Pose) -> Tensor:
    """Return how deep in the nearest walls across each axis a corner is, shape `(W, A)` (m)."""
    return (pose.position.abs() - _limit(room, pose.facing)).clamp(min=0)


def _pushed_back(room: Room, pose: _Pose, depth: Tensor, travel: Tensor) -> Tensor:
    """Return the travel that walls and their friction take from the wheels, shape `(W, A)`.

    For each of the two nearest walls, the corner deepest in it counts. What it does to the wheels
    is written as what both get alike, and what the right one gets more and the left one less.

    Args:
        room: The room's measures.
        pose: Where the robots would be, walls apart.
        depth: How deep in the walls they would be, shape `(W, A)` (m).
        travel: What the wheels would roll, shape `(W, A)`.
    """
    # Half the walls' normals, outwards, in the robots' frames; a row for the walls across an axis.
    half = torch.copysign(torch.full_like(depth, 0.5), pose.position)
    ahead, aside = half * pose.facing, half * _aside(pose.facing)
    # How far a wheel's travel moves the corner into the wall, and along it: both walls turn alike.
    cos, sin = pose.facing.unbind()
    wide, long = pose.facing.abs().unbind()
    lever = torch.full_like(cos, room.chassis / 2 / room.track)
    turn = (wide - long) * torch.copysign(lever, cos * sin)
    arm = (wide + long) * lever
    push = 0.5 * depth / (ahead * ahead + turn * turn)
    both, more = _added(push * ahead), _added(push) * turn
    left, right = (0.5 * travel).unbind()
    slip = arm * (right - left - more) - aside * (right + left - both)
    limit = WALL_FRICTION * push
    rub = (slip / (aside * aside + arm * arm)).clamp(-limit, limit)
    both, more = both - _added(rub * aside), more + _added(rub) * arm
    return torch.stack([both - more, both + more])


def roll(place: Tensor, velocity: Tensor, seconds: float, reach: float) -> Tensor:
    """Return where a ball is that bounces between walls, in closed form, all of one shape.

    Each coordinate keeps to itself. Once the ball has met a wall, bounce n + 1 follows bounce n
    after `2 * reach / speed`, and each bounce leaves `TOY_BOUNCE` of the speed: a geometric series.

    Args:
        place: Where it starts, in [-reach, reach] (m).
        velocity: With which it starts (m/s).
        seconds: How long it rolls (s).
        reach: How far from the middle it can get (m).
    """
    speed, onwards = velocity.abs(), torch.where(velocity < 0, -1.0, 1.0)
    travel = speed * seconds
    first = reach - onwards * place  # to the first wall
    # The path after the first wall, were there no loss, in widths of the room.
    beyond = (travel - first).clamp(min=0) / (2 * reach)
    starts, speeds_left = _bounces(place.dtype, place.device)
    bounce = torch.bucketize(beyond, starts, right=True) - 1  # the last one
    left = speeds_left[bounce]  # of the speed after the first bounce
    since = (beyond - starts[bounce]) * left * TOY_BOUNCE
    end = torch.where(bounce % 2 == 0, 1 - 2 * since, 2 * since - 1) * reach * onwards
    return torch.where(travel < first, place + velocity * seconds, end).clamp(-reach, reach)


@cache
def _bounces(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return when bounces follow the first one, and what they leave of its speed, `(N_BOUNCES,)`.

    When: as paths without loss, in widths of the room.
    """
    starts, speeds, start, speed = [], [], 0.0, 1.0
    for _ in range(N_BOUNCES):
        starts.append(start)
        speeds.append(speed)
        speed = speed * TOY_BOUNCE
        start = start + 1 / speed
    both = torch.tensor([starts, speeds], dtype=dtype, device=device)
    return both[0], both[1]


def wall_distances(room: Room, position: Tensor, directions: Tensor) -> Tensor:
    """Return how far the walls are (m), shape `(beams, A)`.

    Args:
        room: The room's measures.
        position: From where, shape `(W, A)` (m); the room's centre is the origin.
        directions: Cosines and sines of the directions, shape `(W, beams, A)`.
    """
    to_wall = room.side / 2 - directions.sign() * position[:, None]
    across, along = (to_wall / directions.abs()).unbind()
    return torch.minimum(across, along)


def _refuse(actions: Tensor) -> None:
    bounds = zip(layout.ACTION_NAMES, layout.ACTION_LOW, layout.ACTION_HIGH, strict=True)
    for column, (name, low, high) in enumerate(bounds):
        for value in actions[:, column].tolist():
            if not low <= value <= high:  # not-a-number compares false too
                raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {value:.7g}")
