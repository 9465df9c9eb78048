"""Writes a run for the Rerun viewer: the room, the robot's regions and its numbers over time.

Shapes: `T` decisions, `B` beams, `L` leaves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torch_iac.analysis.partition import partitions_of
from torch_iac.analysis.region_history import children_of
from torch_iac.experiment import experiment_of
from torch_iac.internal.files import replace
from torch_iac.replay.scenes import relive_states
from torch_iac.runs.charts import shades
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import WINDOW
from torch_iac.toy_room import WORLDS
from torch_iac.worlds.vector import World

DECISION = "decision"
"""The name of the time line."""

N_MAPS = 100
"""At so many moments the regions are drawn, at most."""

GREY, BLUE, ORANGE, GREEN = [136, 136, 136], [0, 114, 178], [230, 159, 0], [0, 158, 115]
"""Colours of walls, robot, toy and beams."""

TOY_AT = 17
"""Where the toy's position begins in the state of the toy room."""


@dataclass(frozen=True)
class Poses:
    """Where robot and toy were before each decision, in metres from the middle of the room.

    Attributes:
        room: The room's measures.
        robot: Shape `(T, 2)`.
        heading: Shape `(T,)`, anticlockwise (rad).
        toy: Shape `(T, 2)`.
    """

    room: Any
    robot: NDArray[np.float64]
    heading: NDArray[np.float64]
    toy: NDArray[np.float64]


def save_rerun(run: Run, path: Path, agent: int = 0) -> Path:
    """Write a robot's run as a file for the Rerun viewer, and return where it is.

    All is on one time line, `decision`: in the toy rooms the room with robot, beams and toy, whose
    recorded actions are repeated for that; a plane through the regions; cuts; sensors, actions,
    errors, progress and the number of regions.

    Args:
        run: The run.
        path: The file, `.rrd`.
        agent: Which robot.

    Raises:
        ValueError: The name does not end in `.rrd`, Rerun is missing, there is no such robot, its
            steps are not recorded, or its world does not come out as recorded.
    """
    if path.suffix != ".rrd":
        raise ValueError(f"a file for Rerun must be a .rrd, got {path}")
    rr = _imported()
    run.check_recorded(agent)
    poses = poses_of(run, agent)
    path.parent.mkdir(parents=True, exist_ok=True)

    def write(temporary: Path) -> None:
        stream = rr.RecordingStream("torch_iac", recording_id=f"{run.folder.name}-{agent}")
        stream.save(temporary, default_blueprint=_blueprint(run, poses is not None))
        sheet = _Sheet(rr, stream, run, agent)
        sheet.write_numbers()
        sheet.write_cuts()
        sheet.write_regions()
        if poses is not None:
            sheet.write_room(poses)
        stream.disconnect()

    replace(path, write)
    return path


def poses_of(run: Run, agent: int = 0) -> Poses | None:
    """Return where robot and toy of a run were; None if its world is no toy room.

    Raises:
        ValueError: The world does not come out as recorded.
    """
    if run.config.get("world") not in WORLDS:
        return None
    world = experiment_of(run).make_world(1)
    try:
        rows = [_pose(state) for state in relive_states(run, world, agent)]
        robot, heading, toy = (np.array(of) for of in zip(*rows, strict=True))
        return Poses(_room_of(world), robot, heading, toy)
    finally:
        world.close()


def _pose(state: Any) -> tuple[list[float], float, list[float]]:
    """Return the robot's place and heading and the toy's place in a saved state of a toy room."""
    if isinstance(state, Mapping):  # the kinematic room
        x, y, heading = state["robot"][0].tolist()
        return [x, y], heading, state["toy"][0].tolist()
    present = state[0]["present"].tolist()
    x, y, _, _, _, z_turn, w_turn = present[:7]
    return [x, y], 2 * float(np.arctan2(z_turn, w_turn)), present[TOY_AT : TOY_AT + 2]


def _room_of(world: World) -> Any:
    own = getattr(world.unwrapped, "room", None)
    return own if own is not None else world.get_attr("room")[0]  # type: ignore[attr-defined]


def _imported() -> Any:
    try:
        import rerun
    except ImportError:
        raise ValueError("--rerun needs Rerun: pip install 'torch_iac[rerun]'") from None
    return rerun


def _blueprint(run: Run, has_room: bool) -> Any:
    """Return which views the viewer opens with."""
    import rerun.blueprint as rrb

    across, up = _plane(run)
    room = [rrb.Spatial3DView(origin="/room", name="Room")] if has_room else []
    regions = rrb.Spatial2DView(origin="/regions", name=f"Regions: {across} across, {up} up")
    curves = [
        rrb.TimeSeriesView(origin=f"/{name}", name=name.capitalize())
        for name in ("progress", "error", "zones", "n_regions")
        if name != "zones" or run.zone_names
    ]
    left = rrb.Vertical(*room, regions, rrb.TextLogView(origin="/cuts", name="Cuts"))
    return rrb.Blueprint(rrb.Horizontal(left, rrb.Vertical(*curves)), collapse_panels=True)


class _Sheet:
    """Writes what happened to one robot to a stream of Rerun's."""

    def __init__(self, rr: Any, stream: Any, run: Run, agent: int) -> None:
        self._rr, self._stream, self._run, self._agent = rr, stream, run, agent
        self._steps = run.table(agent=agent)
        self._family = run.family(agent).to_pylist()

    def write_numbers(self) -> None:
        """Write what was recorded of each decision, and the number of regions."""
        every = np.arange(len(self._steps))
        for name in self._steps.column_names:
            kind, _, own = name.partition("/")
            if kind in ("action", "sensor") and own:
                self._write_curve(f"{kind}s/{own}", every, self._steps[name].to_numpy())
        for name, column in self._run.error_columns.items():
            self._write_curve(f"error/{name}", every, self._steps[column].to_numpy())
        if self._run.has_expectations:
            expected = self._steps["expected_error"].to_numpy()
            self._write_curve("error/expected", every, expected)
        self._write_curve("progress/of_the_region", every, self._steps["progress"].to_numpy())
        births = [row["born_step"] for row in self._family[1::2]]  # of the first of two children
        n_regions = 1 + np.searchsorted(np.sort(births), every)
        self._write_curve("n_regions/n_regions", every, n_regions.astype(np.float64))
        for zone, name in enumerate(self._run.zone_names):
            here = np.cumsum(np.append(0, self._steps["zone"].to_numpy() == zone))
            since = np.maximum(every + 1 - WINDOW, 0)
            share = (here[every + 1] - here[since]) / (every + 1 - since)
            self._write_curve(f"zones/{name}", every, share)

    def write_cuts(self) -> None:
        """Write a line for each cut."""
        children = children_of(self._family)
        cuts = [row for row in self._family if row["split_step"] >= 0]
        texts = [
            f"region {row['region']} was cut along {row['cut_dimension']} at "
            f"{row['cut_value']:.3g}; its children: {children[row['region']]}"
            for row in cuts
        ]
        if cuts:
            columns = self._rr.TextLog.columns(text=texts)
            self._send("cuts", [row["split_step"] for row in cuts], columns)

    def write_regions(self) -> None:
        """Write the plane through the situation in which the robot is, at some moments.

        The plane's sides are shown as 100 long, since their units differ.
        """
        across, up = _plane(self._run)
        steps = _moments(len(self._steps))
        partitions = partitions_of(self._run, steps, self._agent)
        planes = [
            partition.through(self._situation(step, but=(across, up)))
            for step, partition in zip(steps, partitions, strict=True)
        ]
        sides = [(self._shown(of, across), self._shown(of, up)) for of in planes]
        lows = np.concatenate([np.stack([x[0], 100 - y[1]], -1) for x, y in sides])
        highs = np.concatenate([np.stack([x[1], 100 - y[0]], -1) for x, y in sides])
        progress = np.concatenate([plane.progress for plane in planes])
        columns = self._rr.Boxes2D.columns(
            centers=(lows + highs) / 2,
            half_sizes=(highs - lows) / 2,
            colors=shades(progress, float(np.abs(progress).max()) or 1.0),
            labels=[f"region {n}" for plane in planes for n in plane.regions.tolist()],
            show_labels=np.zeros(len(progress), np.bool_),
        )
        self._send("regions", steps, columns.partition([len(of.regions) for of in planes]))

    def write_room(self, poses: Poses) -> None:
        """Write the room, the robot with its beams, and the toy."""
        rr, room, every = self._rr, poses.room, np.arange(len(self._steps))
        half, height = room.side / 2, room.wall_height
        corners = [[-half, -half], [half, -half], [half, half], [-half, half], [-half, -half]]
        rings = [[[x, y, z] for x, y in corners] for z in (0.0, height)]
        self._stream.log("room/walls", rr.LineStrips3D(rings, colors=[GREY]), static=True)
        side = room.chassis / 2
        body = rr.Boxes3D(
            centers=[[0, 0, side / 2]], half_sizes=[[side, side, side / 2]], colors=[BLUE]
        )
        self._stream.log("room/robot/body", body, static=True)
        ahead = rr.Arrows3D(origins=[[0, 0, side]], vectors=[[2 * side, 0, 0]], colors=[BLUE])
        self._stream.log("room/robot/ahead", ahead, static=True)
        ball = rr.Ellipsoids3D(half_sizes=[[room.toy_radius] * 3], colors=[ORANGE])
        self._stream.log("room/toy/ball", ball, static=True)
        turn = np.zeros((len(every), 4))
        turn[:, 2], turn[:, 3] = np.sin(poses.heading / 2), np.cos(poses.heading / 2)
        for name, place, more in (
            ("robot", poses.robot, {"quaternion": turn}),
            ("toy", poses.toy, {}),
        ):
            height = room.toy_radius if name == "toy" else 0.0
            places = np.concatenate([place, np.full((len(every), 1), height)], axis=1)
            moved = rr.Transform3D.columns(translation=places, **more)
            self._send(f"room/{name}", every, moved)
        self._write_beams(room.beam_height)

    def _write_beams(self, height: float) -> None:
        """Write the robot's beams as long as they were read, in its own frame."""
        names = [name for name in self._steps.column_names if name.startswith("sensor/wall_")]
        if not names:
            return
        lengths = np.stack([self._steps[name].to_numpy() for name in names], axis=1)  # (T, B)
        angles = 2 * np.pi * np.arange(len(names)) / len(names)
        ways = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(names))], axis=1)
        beams = (lengths[..., None] * ways).reshape(-1, 3)
        origins = np.tile([0.0, 0.0, height], (len(beams), 1))
        columns = self._rr.Arrows3D.columns(vectors=beams, origins=origins)
        colour = self._rr.Arrows3D.from_fields(colors=[GREEN], radii=[0.003])
        self._stream.log("room/robot/beams", colour, static=True)
        every = np.arange(len(lengths))
        self._send("room/robot/beams", every, columns.partition([len(names)] * len(every)))

    def _situation(self, step: int, but: Sequence[str]) -> dict[str, float]:
        """Return the situation of a decision, within its bounds, but for some dimensions."""
        dimensions, columns = self._run.space.situation, self._run.situation_columns
        return {
            dimension.name: min(
                max(self._steps[column][step].as_py(), dimension.low), dimension.high
            )
            for dimension, column in zip(dimensions, columns, strict=True)
            if dimension.name not in but
        }

    def _shown(self, plane: Any, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the low and the high sides of boxes along a dimension, from 0 to 100."""
        names = self._run.space.situation_names
        dimension = self._run.space.situation[names.index(name)]
        low, high = (
            100 * (of - dimension.low) / (dimension.high - dimension.low)
            for of in plane.sides(name)
        )
        return low, high

    def _write_curve(
        self, path: str, steps: NDArray[np.int64], values: NDArray[np.floating[Any]]
    ) -> None:
        known = np.isfinite(values)
        columns = self._rr.Scalars.columns(scalars=values[known].astype(np.float64))
        self._send(path, steps[known], columns)

    def _send(self, path: str, steps: Sequence[int] | NDArray[np.int64], columns: Any) -> None:
        time = self._rr.TimeColumn(DECISION, sequence=steps)
        self._stream.send_columns(path, [time], columns, strict=True)


def _plane(run: Run) -> tuple[str, str]:
    """Return the two dimensions that were cut most often; the first ones where none were."""
    cut = run.regions["cut_dimension"].drop_null().to_pylist()
    names = sorted(run.space.situation_names, key=lambda name: -cut.count(name))
    return names[0], names[1]


def _moments(n_decisions: int) -> list[int]:
    """Return evenly spaced decisions, at most `N_MAPS`, from the first on."""
    return list(range(0, n_decisions, -(-n_decisions // N_MAPS)))
