"""What the commands of `torch-iac` do."""

import logging
import re
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from torch_iac.agent import IAC
from torch_iac.bars import tqdm
from torch_iac.checkpoint import Checkpoints, identity
from torch_iac.comparison import (
    PLAN,
    Comparison,
    Job,
    Variant,
    load_comparison,
    part_of,
    read_variants,
    tally_states,
)
from torch_iac.counts import check_count
from torch_iac.memory import check_memory
from torch_iac.options import Compare, Figures, Options, Replay, Resume, split_at_dashes
from torch_iac.processor import described, processor, rounds_alike
from torch_iac.recording import Recorder
from torch_iac.refusals import leave
from torch_iac.runs import CHECKPOINTS, SUMMARY, WINDOW, Run, load_run
from torch_iac.scenes import find_stages, relive, stages_at
from torch_iac.settings import Train, settings_of
from torch_iac.training import World, train
from torch_iac.workers import carry_out, on_processes, on_ray
from torch_iac.worlds import OTHER_WORLD_BYTES, WORLD_BYTES, WORLDS

PICTURE_MODES = ("rgb_array_list", "rgb_array")
"""How worlds draw pictures: of all moments of a decision, or of its end."""

THREADED_AGENTS = 32
"""With fewer robots, tensors are so small that sharing work between threads costs time."""

OFTEN_CLIPPED, N_CLIPPED_SHOWN = 0.01, 3
"""The report speaks of sensors that are clipped in such a share of the decisions, and names a few.
"""

STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a run after the present decision."""

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
    from torch_iac.figures import save_figures  # with matplotlib, of which training has no need

    save_figures(out)
    print(_report(load_run(out)))  # noqa: T201 - the command's answer


def _develop(settings: Train, agent: IAC, env: World, recorder: Recorder) -> None:
    """Train; whatever ends it early comes with how to go on."""
    out = recorder.folder
    saved = Checkpoints(out / CHECKPOINTS, identity(agent, world=settings.world_identity()))
    steps, every = settings.steps, settings.checkpoint_every
    try:
        with recorder, _stopping() as stop:
            if not train(agent, env, steps, recorder, saved, checkpoint_every=every, stop=stop):
                where = f"stopped after decision {agent.n_decisions}"
                raise StoppedError(stop.signals[0], f"{where}; {_how_to_go_on(out)}")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; {_how_to_go_on(out)}") from None
    except OSError as error:
        raise OSError(f"{_sentence(error)}; {_how_to_go_on(out)}") from error


def resume(asked: Resume) -> None:
    """Carry `torch-iac resume` out.

    Raises:
        FileNotFoundError: The folder holds no run.
        ValueError: It is none of `torch-iac train`, or it has ended with as many decisions.
    """
    run = load_run(asked.run_folder)
    words = _words_of(run)
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


def _words_of(run: Run) -> list[str]:
    """Return the command that a run was begun with.

    Raises:
        ValueError: It was not begun by this command.
    """
    words = run.config.get("command")
    if not isinstance(words, list) or words[:2] != ["torch-iac", "train"]:
        raise ValueError(f"{run.folder} must be a run of torch-iac train, got {words}")
    return [str(word) for word in words]


def compare(asked: Compare, words: Sequence[str]) -> None:
    """Carry `torch-iac compare` out; `words` are options for all runs.

    Raises:
        StoppedError: It was asked to stop, and the runs have saved themselves.
        ValueError: Something of it is refused; the message says the rule and the value.
    """
    comparison = _comparison(asked, words)
    if not asked.report:
        _carry_out(asked, comparison)
    _answer(asked, comparison)


def _comparison(asked: Compare, words: Sequence[str]) -> Comparison:
    """Return what the folder holds, if anything, and what is asked for besides."""
    check_count("processes", asked.processes)
    given = read_variants(asked.variants) if asked.variants else ()
    given += tuple(Variant.from_text(text) for text in asked.variant)
    numbers = {"n_seeds": asked.seeds, "seed": asked.seed, "block": asked.block}
    folder = asked.folder.absolute()  # where the workers are, another may be the present one
    if (folder / PLAN).exists():
        return load_comparison(folder).grown(given, words, **numbers)
    known = {name: number for name, number in numbers.items() if number is not None}
    return Comparison(folder, given, tuple(words), **known)


def _carry_out(asked: Compare, comparison: Comparison) -> None:
    """Carry out the runs that are not done."""
    jobs = comparison.jobs()
    sizes = _sizes(jobs, elsewhere=asked.ray is not None)
    open_jobs = [job for job in _part(jobs, asked) if job.state != "done"]
    if asked.ray is None:
        crew = on_processes(open_jobs, go_on, asked.processes)
    else:
        crew = on_ray(open_jobs, go_on, asked.ray, asked.gpus)
    comparison.save()
    with _stopping() as stop:
        is_over = carry_out({job: sizes[job] for job in open_jobs}, crew, stop)
    if not is_over:
        raise StoppedError(
            stop.signals[0], f"stopped; go on with: torch-iac compare {asked.folder}"
        )


def _part(jobs: Sequence[Job], asked: Compare) -> Sequence[Job]:
    """Return the runs that a command is about."""
    return part_of(jobs, asked.only) if asked.only else jobs


def _sizes(jobs: Sequence[Job], elsewhere: bool) -> dict[Job, int]:
    """Return how many decisions the robots of each run take together, if all can be run.

    Raises:
        ValueError: One cannot; the message names its variant.
    """
    steps = {}
    for job in {job.variant: job for job in jobs}.values():
        try:
            settings = settings_of(job.words[2:])
            settings.check(elsewhere=elsewhere)
        except (ValueError, gym.error.Error) as error:
            raise ValueError(f"variant {job.variant}: {error}") from None
        steps[job.variant] = settings.steps
    for job in jobs:
        job.check()
    return {job: steps[job.variant] * len(job.seeds) for job in jobs}


def _answer(asked: Compare, comparison: Comparison) -> None:
    """Report, and say where, and which runs failed."""
    from torch_iac.report import save_report  # with scipy and matplotlib

    mine = _part(comparison.jobs(), asked)
    lines = [f"{len(mine)} run{'s' if len(mine) != 1 else ''}: {tally_states(mine)}."]
    if asked.only is None and any(job.state == "done" for job in mine):
        lines.append(f"Read {save_report(comparison)}, or: tensorboard --logdir {asked.folder}")
    print("\n".join(lines))  # noqa: T201 - the command's answer
    failed = [job for job in mine if job.state == "failed"]
    if failed:
        leave(1, "\n".join(f"{job.name} failed: {job.reason}" for job in failed))


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


def draw(asked: Figures) -> None:
    """Carry `torch-iac figures` out."""
    from torch_iac.figures import save_figures  # with matplotlib

    for path in save_figures(asked.run_folder, pdf=asked.pdf):
        print(path)  # noqa: T201 - the command's answer


def replay(asked: Replay) -> None:
    """Carry `torch-iac replay` out.

    Raises:
        FileNotFoundError: The folder holds no run.
        ValueError: The robot, a decision or the film's name is refused, the world draws no
            pictures, or it does not come out as recorded.
    """
    from torch_iac.video import Film, writer_for  # with matplotlib

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
    from torch_iac.sheets import ROOM

    settings = settings_of(_words_of(run)[2:])
    world = settings.make_world(1)
    modes = [mode for mode in PICTURE_MODES if mode in world.metadata.get("render_modes", ())]
    if not modes:
        world.close()
        raise ValueError(f"the world of {run.folder} draws no pictures, so it cannot be replayed")
    size = dict(zip(("width", "height"), ROOM, strict=True)) if settings.world in WORLDS else {}
    looks = [f"{name}={value}" for name, value in {"render_mode": modes[0], **size}.items()]
    options = (*settings.world_options, *looks)
    return world, replace(settings, world_options=options).make_world(1)


def run(asked: Train | Options, words: Sequence[str]) -> None:
    """Carry a command out; what ends it early ends the program.

    Args:
        asked: What it was told.
        words: What the user typed after `torch-iac`.
    """
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        if isinstance(asked, Train):
            begin(asked, ["torch-iac", *words])
        elif isinstance(asked, Compare):
            compare(asked, split_at_dashes(words)[1])
        elif isinstance(asked, Resume):
            resume(asked)
        elif isinstance(asked, Figures):
            draw(asked)
        else:
            replay(asked)
    except (ValueError, OSError, FloatingPointError, gym.error.Error) as error:
        leave(2, _sentence(error))
    except StoppedError as stopped:
        leave(128 + stopped.signal, str(stopped))
    except KeyboardInterrupt as interrupt:
        leave(130, str(interrupt) or "interrupted")


def _sentence(error: Exception) -> str:
    """Return what an error says, in one line, without the number of the operating system."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(text.split())


class StoppedError(Exception):
    """A command was asked to stop, and did so; the sentence says how to go on.

    Attributes:
        signal: The number of the signal that asked.
    """

    def __init__(self, number: int, sentence: str) -> None:
        super().__init__(sentence)
        self.signal = number


def _how_to_go_on(folder: Path) -> str:
    return f"go on with: torch-iac resume {folder}"


class _Stop:
    """Whether the user, or the machine, has asked a run to stop.

    Attributes:
        signals: What was received.
    """

    def __init__(self) -> None:
        self.signals: list[int] = []

    def __call__(self) -> bool:
        return bool(self.signals)

    def receive(self, number: int, frame: object) -> None:
        """Note a signal; the second does not wait for the decision to end."""
        del frame
        if self.signals:
            raise KeyboardInterrupt
        self.signals.append(number)


@contextmanager
def _stopping() -> Iterator[_Stop]:
    """Take Ctrl-C and a request to terminate as a wish to stop after the present decision."""
    stop = _Stop()
    before = {number: signal.signal(number, stop.receive) for number in STOPPING}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _report(run: Run) -> str:
    """Return in words what the robots did, and where to look."""
    summary = run.summary
    who = "The robot" if run.n_agents == 1 else f"Each of {run.n_agents:,} robots"
    lines = [
        f"{who} took {run.n_decisions:,} decisions in {summary['seconds']:.0f} s "
        f"({summary['decisions_per_second']:.0f} a second) "
        f"and made {summary['n_regions']:.0f} region{'s' if summary['n_regions'] != 1 else ''}."
    ]
    for name, cuts in summary["first_cuts"].items():
        lines.append(
            f"First cut: {name} at {cuts['median_value']:.3g}, "
            f"at decision {cuts['median_step']:.0f}{_share(cuts, run)}."
        )
    for zone, focus in summary["focus"].items():
        if focus["n_agents"]:
            lines.append(
                f"Focus on {zone}: from decision {focus['median_step']:.0f}{_share(focus, run)}."
            )
        else:
            lines.append(f"Focus on {zone}: never.")
    if "zone_shares" in summary:
        shares = ", ".join(f"{zone} {share:.0%}" for zone, share in summary["zone_shares"].items())
        lines.append(f"Time: {shares}.")
    if run.n_recorded < run.n_agents:
        lines.append(
            f"Every decision is recorded of the first {run.n_recorded} robots, "
            f"windows of {WINDOW} decisions of all {run.n_agents:,}."
        )
    clipped = _clipped(run)
    if clipped:
        worst = sorted(clipped, key=clipped.__getitem__, reverse=True)[:N_CLIPPED_SHOWN]
        shares = ", ".join(f"{name} {clipped[name]:.0%}" for name in worst)
        more = f" and {len(clipped) - len(worst)} more" if len(clipped) > len(worst) else ""
        lines.append(f"At their bounds or beyond: {shares}{more}; see --sensor-bounds.")
    lines.append(f"Look at {run.folder / 'figures'}, or: tensorboard --logdir {run.folder.parent}")
    return "\n".join(lines)


def _clipped(run: Run) -> dict[str, float]:
    """Return the sensors that were often clipped, each with its share of the decisions."""
    names = [name for of in run.config["world"].get("bounds", {}).values() for name in of]
    clipped = [sensor for sensor in run.space.sensors if sensor.name in names]
    shares = {}
    for sensor in clipped:
        read = run.column(f"sensor/{sensor.name}")
        at_bound = (read <= np.float32(sensor.low)) | (read >= np.float32(sensor.high))
        shares[sensor.name] = float(at_bound.mean())
    return {name: share for name, share in shares.items() if share >= OFTEN_CLIPPED}


def _share(count: Mapping[str, Any], run: Run) -> str:
    return "" if run.n_agents == 1 else f" (median; {count['n_agents']} of {run.n_agents} robots)"
