"""The commands `torch-iac train` and `torch-iac resume`."""

import logging
import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import torch

from torch_iac.agent import IAC
from torch_iac.cli.answer import report_of
from torch_iac.cli.commands import Resume
from torch_iac.cli.exits import StoppedError, one_line, stopping
from torch_iac.cli.memory_estimate import check_memory
from torch_iac.cli.options import Train, settings_of, words_of
from torch_iac.internal.processor import described, processor, rounds_alike
from torch_iac.runs.checkpoint import Checkpoints, identity
from torch_iac.runs.reader import load_run
from torch_iac.runs.recorder import Recorder
from torch_iac.runs.schema import CHECKPOINTS, SUMMARY
from torch_iac.toy_room import OTHER_WORLD_BYTES, WORLD_BYTES
from torch_iac.training import train
from torch_iac.worlds.vector import World

THREADED_AGENTS = 32
"""With fewer robots, tensors are so small that sharing work between threads costs time."""

log = logging.getLogger(__name__)


def begin(settings: Train, words: Sequence[str]) -> None:
    """Carry `torch-iac train` out; `words` are what the user typed."""
    world = re.sub(r"[^\w.-]", "-", settings.world)
    out = settings.out or Path("runs") / f"{datetime.now():%Y%m%d-%H%M%S}-{world}"
    live(settings, out, words)


def live(settings: Train, out: Path, words: Sequence[str], resume: bool = False) -> None:
    """Let robots develop in a new run folder, or go on in the one that they have.

    Args:
        settings: What `torch-iac train` was told.
        out: The run folder.
        words: The whole command, for `config.json`.
        resume: Whether the folder holds this run already, begun before.

    Raises:
        StoppedError: It was asked to stop, and has saved itself.
        ValueError: Something of it is refused; the message says the rule and the value.
        OSError: The folder holds another run, or cannot be written.
    """
    if settings.agents < THREADED_AGENTS:
        torch.set_num_threads(1)
    bounds, config, device = settings.bounds(), settings.config(), settings.torch_device()
    space, n_agents, n_recorded = settings.space(bounds), settings.agents, settings.n_recorded()
    need = (space, config, n_agents, settings.steps, n_recorded)
    check_memory(*need, device, WORLD_BYTES.get(settings.world, OTHER_WORLD_BYTES))
    if bounds is not None and bounds.found:
        share = f"{len(bounds.found)} of {len(space.sensors)} sensors"
        log.info("Bounds for %s were found in %s random decisions", share, settings.bounds_from)
    description = settings.description(words, bounds)
    if resume:  # the processor that it began on stays in config.json
        description["processor"] = load_run(out).config.get("processor")
    env = settings.make_world(n_agents, bounds)
    try:
        agent = IAC(space, config, range(settings.seed, settings.seed + n_agents), device)
        recorder = Recorder(
            out,
            agent,
            env.metadata.get("zone_names"),
            description,
            log_every=settings.log_every,
            n_recorded=n_recorded,
            resume=resume,
        )
        _develop(settings, agent, env, recorder)
    finally:
        env.close()
    from torch_iac.analysis.figures import (
        save_figures,  # with matplotlib, of which training has no need
    )

    save_figures(out)
    print(report_of(load_run(out)))  # noqa: T201 - the command's answer


def _develop(settings: Train, agent: IAC, env: World, recorder: Recorder) -> None:
    """Train; whatever ends it early comes with how to go on."""
    out = recorder.folder
    saved = Checkpoints(out / CHECKPOINTS, identity(agent, world=settings.world_identity()))
    steps, every = settings.steps, settings.checkpoint_every
    try:
        with recorder, stopping() as stop:
            if not train(agent, env, steps, recorder, saved, checkpoint_every=every, stop=stop):
                where = f"stopped after decision {agent.n_decisions}"
                raise StoppedError(stop.signals[0], f"{where}; {_how_to_go_on(out)}")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {_how_to_go_on(out)}") from None
    except OSError as error:
        raise OSError(f"{one_line(error)}; {_how_to_go_on(out)}") from error


def resume(asked: Resume) -> None:
    """Carry `torch-iac resume` out.

    Raises:
        FileNotFoundError: The folder holds no run.
        ValueError: It is none of `torch-iac train`, or it has ended with as many decisions.
    """
    run = load_run(asked.run_folder)
    words = words_of(run)
    settings = settings_of(words[2:])
    steps = asked.steps or run.config["steps"]
    if (asked.run_folder / SUMMARY).exists() and steps <= run.n_decisions:
        raise ValueError(
            f"steps must be above the {run.n_decisions} that {asked.run_folder} has ended with, "
            f"got {steps}"
        )
    began_on, here = run.config.get("processor"), processor()
    if not rounds_alike(began_on, here, settings.is_exact()):
        log.info(
            "The run began on another kind of processor (%s) than this one (%s): "
            "the last digits may differ from here on",
            *(described(of) for of in (began_on, here)),
        )
    live(replace(settings, steps=steps), asked.run_folder, words, resume=True)


def go_on(words: Sequence[str], folder: Path) -> None:
    """Begin a run of a comparison, or go on with it if it has begun.

    Raises:
        KeyboardInterrupt: It was asked to stop, and has saved itself.
    """
    settings = settings_of(words[2:])
    try:
        live(settings, folder, words, resume=folder.exists())
    except StoppedError as stopped:
        raise KeyboardInterrupt(str(stopped)) from None


def _how_to_go_on(folder: Path) -> str:
    return f"go on with: torch-iac resume {folder}"
