"""The command `torch-iac replay`."""

from typing import Any

from torch_iac.cli.commands import Replay
from torch_iac.experiment import experiment_of
from torch_iac.internal.bars import tqdm
from torch_iac.replay.scenes import find_stages, relive, stages_at
from torch_iac.runs.reader import Run, load_run
from torch_iac.toy_room import WORLDS
from torch_iac.worlds.bounds import recorded_bounds
from torch_iac.worlds.vector import World

PICTURE_MODES = ("rgb_array_list", "rgb_array")
"""Render modes: pictures of all moments of a decision, or of its end."""


def replay(asked: Replay) -> None:
    """Run `torch-iac replay`.

    Raises:
        FileNotFoundError: The folder holds no run.
        ValueError: The robot, a decision or the film's name is refused, the world draws no
            pictures, or it does not come out as recorded.
    """
    from torch_iac.replay.film import Film, writer_for  # with matplotlib

    run = load_run(asked.run_folder)
    out = asked.out or run.folder / "figures" / "replay.mp4"
    writer_for(out)  # refuses a wrong name now
    run.check_recorded(asked.agent)
    if asked.at:
        stages = stages_at(run, asked.at, asked.decisions)
    else:
        stages = find_stages(run, asked.agent, asked.decisions)
    world, camera = _remake(run)
    try:
        scenes = tqdm(
            relive(run, stages, world, camera, asked.agent),
            unit="decision",
            total=sum(stage.n_decisions for stage in stages),
            disable=None,
        )
        Film(run, asked.agent, camera.metadata).save(scenes, out)
    finally:
        world.close()
        camera.close()
    print(out)  # noqa: T201 - the command's answer


def _remake(run: Run) -> tuple[World, World]:
    """Return the world of one robot of a run, and the same again for looking at.

    Raises:
        ValueError: It draws no pictures.
    """
    from torch_iac.replay.frames import ROOM

    experiment, bounds = experiment_of(run), recorded_bounds(run.config)

    def made(**options: Any) -> World:
        world = experiment.make_world(1, **options)
        return world if bounds is None else bounds.clip(world)

    world = made()
    modes = [mode for mode in PICTURE_MODES if mode in world.metadata.get("render_modes", ())]
    if not modes:
        world.close()
        raise ValueError(f"the world of {run.folder} draws no pictures, so it cannot be replayed")
    is_ours = experiment.world in WORLDS
    size = dict(zip(("width", "height"), ROOM, strict=True)) if is_ours else {}
    return world, made(render_mode=modes[0], **size)
