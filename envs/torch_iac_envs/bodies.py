"""The bodies in the toy room, as pybullet builds them.

The room is bounded by half-spaces, which nothing can tunnel through, drawn as walls. The robot is
a box on two wheels, each on a revolute joint with a velocity motor, held level by two smooth
skids. A wheel touches the floor as a thin disc does, in one point: its collision shape is a
sphere, its picture a cylinder. The toy is a ball that bounces off the walls. Robot and toy pass
through each other, because the toy must be able to be in the robot.
"""

import math
from typing import Any

from torch_iac_envs.bullet import pybullet as p
from torch_iac_envs.room import ACCELERATION, Room

GRAVITY = 9.81
"""In m/s2."""
SLICE = 0.1
"""How much time one call of the engine advances (s); a decision is a whole number of them."""
SOLVER_ITERATIONS = 15
"""How often the engine's solver goes over all contacts in a physics step."""

ROBOT_MASS, WHEEL_MASS, TOY_MASS = 2.0, 0.1, 0.1
"""Of the chassis, of each wheel and of the ball (kg)."""
CHASSIS_HEIGHT = 0.08
"""In m."""
SKID_RADIUS = 0.02
"""In m."""
SKID_CLEARANCE = 0.001
"""Over the floor (m); without it the skids would carry the weight that gives wheels grip."""
WALL_THICKNESS = 0.06
"""In m, of the picture only."""

RAY, FLOOR, WALL, CHASSIS, WHEEL, TOY = 1, 2, 4, 8, 16, 32
"""Collision groups; the engine puts every ray in group 1."""
TOUCHES = {
    FLOOR: CHASSIS | WHEEL | TOY,
    WALL: CHASSIS | TOY | RAY,
    CHASSIS: FLOOR | WALL,
    WHEEL: FLOOR,
    TOY: FLOOR | WALL | RAY,
}
"""Which groups each may touch."""
FRICTION = {FLOOR: 0.5, WALL: 2.0, CHASSIS: 0.05, WHEEL: 3.0, TOY: 0.02}
"""The engine multiplies the two bodies' numbers: floor and wheel 1.5, floor and skid 0.025."""
BOUNCE = {FLOOR: 0.0, WALL: 1.0, CHASSIS: 0.0, WHEEL: 0.0, TOY: 0.9}
"""Restitution, the share of the speed that a bounce leaves; again the two bodies' product."""

SAND, SLATE, BLUE, WHITE, DARK, RED = (
    (0.86, 0.82, 0.74, 1.0),
    (0.45, 0.52, 0.62, 1.0),
    (0.16, 0.42, 0.75, 1.0),
    (0.95, 0.95, 0.97, 1.0),
    (0.12, 0.13, 0.15, 1.0),
    (0.90, 0.25, 0.16, 1.0),
)
"""Red, green, blue and opacity, in [0, 1]."""

Client = dict[str, int]
"""The keyword argument that tells pybullet which client is meant."""
Point = tuple[float, float, float]
"""Its x, y and z (m)."""


def build(client: Client, room: Room, substeps: int) -> tuple[int, int]:
    """Empty the client, build the room in it and return the robot's and the toy's numbers.

    Args:
        client: The keyword argument that tells pybullet which client is meant.
        room: The room's measures.
        substeps: Physics steps in one `SLICE`.
    """
    p.resetSimulation(**client)  # resets gravity and the solver's settings too
    p.setGravity(0, 0, -GRAVITY, **client)
    p.setPhysicsEngineParameter(
        fixedTimeStep=SLICE,
        numSubSteps=substeps,
        numSolverIterations=SOLVER_ITERATIONS,
        deterministicOverlappingPairs=1,
        **client,
    )
    _build_floor(client, room)
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        _build_wall(client, room, x, y)
    return _build_robot(client, room), _build_toy(client, room)


def motor_torque(room: Room) -> float:
    """Return the greatest torque of a wheel's motor (N m)."""
    return ACCELERATION * (ROBOT_MASS + 2 * WHEEL_MASS) * room.wheel_radius / 2


def _build_floor(client: Client, room: Room) -> None:
    half, thick = room.side / 2, 0.02
    slab = _picture(
        client,
        p.GEOM_BOX,
        SAND,
        halfExtents=(half, half, thick),
        visualFramePosition=(0, 0, -thick),
    )
    _build_half_space(client, FLOOR, slab, (0, 0, 0), (0, 0, 1))


def _build_wall(client: Client, room: Room, x: int, y: int) -> None:
    half, thick, high = room.side / 2, WALL_THICKNESS / 2, room.wall_height / 2
    # The walls across x are longer, to close the corners.
    size = (thick, half + 2 * thick, high) if x else (half, thick, high)
    middle = (x * thick, y * thick, high)
    panel = _picture(client, p.GEOM_BOX, SLATE, halfExtents=size, visualFramePosition=middle)
    _build_half_space(client, WALL, panel, (x * half, y * half, 0), (-x, -y, 0))


def _build_half_space(client: Client, group: int, picture: int, at: Point, normal: Point) -> None:
    plane = p.createCollisionShape(p.GEOM_PLANE, planeNormal=normal, **client)
    body = p.createMultiBody(0, plane, picture, at, **client)
    _finish(client, body, -1, group)


def _build_robot(client: Client, room: Room) -> int:
    disc = p.getQuaternionFromEuler((math.pi / 2, 0, 0))
    wheel = p.createCollisionShape(p.GEOM_SPHERE, radius=room.wheel_radius, **client)
    tyre = _picture(
        client,
        p.GEOM_CYLINDER,
        DARK,
        radius=room.wheel_radius,
        length=0.025,
        visualFrameOrientation=disc,
    )
    robot: int = p.createMultiBody(
        ROBOT_MASS,
        _chassis_shape(client, room),
        _chassis_picture(client, room),
        (0, 0, room.wheel_radius),
        linkMasses=(WHEEL_MASS, WHEEL_MASS),
        linkCollisionShapeIndices=(wheel, wheel),
        linkVisualShapeIndices=(tyre, tyre),
        linkPositions=((0, room.track / 2, 0), (0, -room.track / 2, 0)),
        linkOrientations=((0, 0, 0, 1),) * 2,
        linkInertialFramePositions=((0, 0, 0),) * 2,
        linkInertialFrameOrientations=((0, 0, 0, 1),) * 2,
        linkParentIndices=(0, 0),
        linkJointTypes=(p.JOINT_REVOLUTE,) * 2,
        linkJointAxis=((0, 1, 0),) * 2,
        **client,
    )
    for link, group in ((-1, CHASSIS), (0, WHEEL), (1, WHEEL)):
        _finish(client, robot, link, group)
    return robot


def _chassis_shape(client: Client, room: Room) -> int:
    """Return a box with a skid under its front and its back; the frame is at the wheels' axle."""
    half = room.chassis / 2
    skid_height = SKID_RADIUS + SKID_CLEARANCE - room.wheel_radius
    # Lists, not tuples, which crash the process in the engine.
    shape: int = p.createCollisionShapeArray(
        [p.GEOM_BOX, p.GEOM_SPHERE, p.GEOM_SPHERE],
        halfExtents=[[half, half, CHASSIS_HEIGHT / 2], [0, 0, 0], [0, 0, 0]],
        radii=[0, SKID_RADIUS, SKID_RADIUS],
        collisionFramePositions=[
            [0, 0, CHASSIS_HEIGHT / 2 + 0.01],
            [0.1, 0, skid_height],
            [-0.1, 0, skid_height],
        ],
        **client,
    )
    return shape


def _chassis_picture(client: Client, room: Room) -> int:
    half, top = room.chassis / 2, CHASSIS_HEIGHT + 0.01
    shape: int = p.createVisualShapeArray(
        [p.GEOM_BOX, p.GEOM_CYLINDER, p.GEOM_BOX],
        halfExtents=[[half, half - 0.025, CHASSIS_HEIGHT / 2], [0, 0, 0], [0.02, 0.07, 0.006]],
        radii=[0, 0.05, 0],
        lengths=[0, 0.05, 0],
        visualFramePositions=[
            [0, 0, CHASSIS_HEIGHT / 2 + 0.01],
            [0, 0, top + 0.025],
            [half - 0.03, 0, top],
        ],
        rgbaColors=[BLUE, WHITE, WHITE],
        **client,
    )
    return shape


def _build_toy(client: Client, room: Room) -> int:
    ball = p.createCollisionShape(p.GEOM_SPHERE, radius=room.toy_radius, **client)
    picture = _picture(client, p.GEOM_SPHERE, RED, radius=room.toy_radius)
    place = (0, 0, room.toy_radius)
    # Only a body in maximal coordinates can be swept between two steps, so that a fast toy turns
    # round at the wall and not behind it.
    toy: int = p.createMultiBody(
        TOY_MASS, ball, picture, place, useMaximalCoordinates=True, **client
    )
    p.changeDynamics(toy, -1, ccdSweptSphereRadius=0.8 * room.toy_radius, **client)
    _finish(client, toy, -1, TOY)
    return toy


def _picture(client: Client, kind: int, colour: tuple[float, ...], **shape: Any) -> int:
    number: int = p.createVisualShape(kind, rgbaColor=colour, **shape, **client)
    return number


def _finish(client: Client, body: int, link: int, group: int) -> None:
    p.setCollisionFilterGroupMask(body, link, group, TOUCHES[group], **client)
    p.changeDynamics(
        body,
        link,
        lateralFriction=FRICTION[group],
        restitution=BOUNCE[group],
        linearDamping=0,
        angularDamping=0,
        jointDamping=0,
        **client,
    )
