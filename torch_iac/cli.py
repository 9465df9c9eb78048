"""The command `torch-iac`."""

import io
import logging
import os
import platform
import signal
import sys
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from importlib.metadata import version
from inspect import signature
from json import loads
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn
from warnings import catch_warnings

import gymnasium as gym
import torch
import tyro
from gymnasium.envs.registration import load_env_creator

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac.agent import IAC, available_device
from torch_iac.checkpoint import Checkpoints, identity
from torch_iac.choices import Choice, Greedy, Proportional, Softmax
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
from torch_iac.config import PRESETS, IACConfig
from torch_iac.counts import check_count
from torch_iac.drives import (
    AbsoluteProgress,
    Curriculum,
    Drive,
    Error,
    GlobalProgress,
    Improvement,
    MetaProgress,
    Novelty,
    Progress,
    Random,
)
from torch_iac.experts import Experts, KNNExperts, MLPExperts
from torch_iac.figures import save_figures
from torch_iac.memory import check_memory
from torch_iac.meta import ImprovementPredictor, MetaPredictor
from torch_iac.recording import Recorder
from torch_iac.refusals import plain_refusals
from torch_iac.report import save_report
from torch_iac.runs import CHECKPOINTS, SUMMARY, WINDOW, Run, load_run
from torch_iac.space import SensorimotorSpace
from torch_iac.training import CHECKPOINT_EVERY, World, train
from torch_iac.workers import carry_out, on_processes, on_ray

WORLDS = {
    "toyroom": "torch_iac_envs/ToyRoom-v0",
    "kinematic": "torch_iac_envs/ToyRoomKinematic-v0",
}
OUTCOMES = {"toyroom": ("toy_distance",), "kinematic": ("toy_distance",)}
WORLD_BYTES = {"toyroom": 30_000_000, "kinematic": 4_000}
"""What a world takes in the main memory; with pybullet it is a whole physics engine."""

EXPERTS: dict[str, type[Experts]] = {"knn": KNNExperts, "mlp": MLPExperts}
DRIVES: dict[str, type[Drive]] = {
    "progress": Progress,
    "meta_progress": MetaProgress,
    "absolute_progress": AbsoluteProgress,
    "global_progress": GlobalProgress,
    "error": Error,
    "novelty": Novelty,
    "improvement": Improvement,
    "curriculum": Curriculum,
    "random": Random,
}
CHOICES: dict[str, type[Choice]] = {
    "greedy": Greedy,
    "proportional": Proportional,
    "softmax": Softmax,
}
ExpertsName = Literal["knn", "mlp"]
ChoiceName = Literal["greedy", "proportional", "softmax"]
DriveName = Literal[
    "progress",
    "meta_progress",
    "absolute_progress",
    "global_progress",
    "error",
    "novelty",
    "improvement",
    "curriculum",
    "random",
]

KINDS = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    str | None: "a text or null",
}
"""What an argument of a world may be, in words."""

SEEDS = 2**32
"""Seeds lie below; every random number generator takes them."""

THREADED_AGENTS = 32
"""With fewer robots, tensors are so small that sharing work between threads costs time."""

STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a run after the present decision."""

PACKAGES = ("torch_iac", "torch", "numpy", "gymnasium", "pybullet")


log = logging.getLogger(__name__)

Plain = tyro.conf.arg(name="")
"""The options of a part are named without the part's own name before theirs."""


@dataclass(frozen=True, kw_only=True)
class Settings(IACConfig):
    """The engine's numbers, as options of the command; `Any` is what the default is."""

    experts: Annotated[Any, Plain] = field(default_factory=KNNExperts)
    """What predicts the outcome in each region."""
    drive: Annotated[Any, Plain] = field(default_factory=Progress)
    """What a candidate action is worth."""
    choice: Annotated[Any, Plain] = field(default_factory=Greedy)
    """Which candidate is taken, given what each is worth."""
    shadows: tyro.conf.Suppress[Mapping[str, Experts]] = field(default_factory=dict)


@dataclass(frozen=True)
class Train:
    """Let robots develop in a world and write down what they do.

    The run folder holds every decision, every region, TensorBoard's files, a summary and the
    paper's figures.
    """

    world: Literal["toyroom", "kinematic"] = "toyroom"
    """Where the robots live: the toy room, simulated by pybullet, or its twin in plain arithmetic,
    for thousands of robots at once."""
    preset: Literal["iac2004", "iac2007"] = "iac2004"
    """Which paper's numbers the options start from; they are the defaults shown here."""
    experts: ExpertsName = "knn"
    """What predicts in each region; its own options are among those below."""
    shadows: tuple[ExpertsName, ...] = ()
    """Other experts, which predict and learn on the same stream without any influence."""
    drive: DriveName = "progress"
    """What the robot wants; its own options are among those below."""
    choice: ChoiceName = "greedy"
    """Which candidate action is taken, given what each is worth."""
    mp: bool = True
    """Whether the meta-predictor MP learns what errors to expect; some drives need it."""
    steps: int = 10_000
    """How many decisions each robot takes."""
    seed: int = 0
    """Seed of the first robot; each further one has the next."""
    agents: int = 1
    """How many robots, each in a world of its own."""
    out: Path | None = None
    """The run folder; by default a new one in runs/, named by the time."""
    device: str = "cpu"
    """Where the robots think and the kinematic world is: cpu, cuda, cuda:1, ... or auto (cuda if
    there is one)."""
    outcomes: tuple[str, ...] = ()
    """The sensors to predict, or all; by default what the paper predicts in that world."""
    world_options: tuple[str, ...] = ()
    """Arguments of the world, such as beams=4 sensor_noise=0."""
    log_every: int = 100
    """How many decisions lie between two logs to TensorBoard; more after the first 1,000 logs."""
    recorded_rows: int = 20_000_000
    """Every decision of every robot is recorded if that makes at most so many rows, of about 65
    bytes each on disk; otherwise those of the first robots only, and tallies of all."""
    recorded_agents: int = 64
    """How many those first robots are."""
    checkpoint_every: int = CHECKPOINT_EVERY
    """How many decisions lie between two checkpoints, or more where they would take over a
    twentieth of the time."""
    iac: Annotated[Settings, Plain] = field(default_factory=Settings)

    def __post_init__(self) -> None:
        for name in ("steps", "agents", "log_every", "checkpoint_every", "recorded_agents"):
            check_count(name, getattr(self, name))
        check_count("recorded_rows", self.recorded_rows, least=0)
        if not 0 <= self.seed < SEEDS:
            raise ValueError(f"seed must lie in [0, {SEEDS}), got {self.seed}")

    def run(self, words: Sequence[str]) -> None:
        """Carry the command out; `words` are what the user typed."""
        out = self.out or Path("runs") / f"{datetime.now():%Y%m%d-%H%M%S}-{self.world}"
        self.live(out, words)

    def live(self, out: Path, words: Sequence[str], resume: bool = False) -> None:
        """Let the robots develop in a new run folder, or go on in the one that they have."""
        if self.agents < THREADED_AGENTS:
            torch.set_num_threads(1)
        options = _options(self.world_options)
        device = _device(self.device)
        space = self._space(options, device)
        n_recorded = self._n_recorded()
        need = (space, self._iac(), self.agents, self.steps, n_recorded)
        check_memory(*need, device, WORLD_BYTES[self.world])
        env = _make_world(self.world, self.agents, options, device)
        try:
            seeds = range(self.seed, self.seed + self.agents)
            agent = IAC(space, self._iac(), seeds, device)
            recorder = Recorder(
                out,
                agent,
                env.metadata.get("zone_names"),
                self._description(words, options),
                log_every=self.log_every,
                n_recorded=n_recorded,
                resume=resume,
            )
            self._develop(agent, env, recorder, options)
        finally:
            env.close()
        save_figures(out)
        print(_report(load_run(out)))  # noqa: T201 - the command's answer

    def check(self, elsewhere: bool = False) -> None:
        """Refuse what the world refuses, and a device that is not here, unless it is elsewhere."""
        device = torch.device("cpu") if elsewhere else _device(self.device)
        self._space(_options(self.world_options), device)

    def _develop(
        self, agent: IAC, env: World, recorder: Recorder, options: Mapping[str, Any]
    ) -> None:
        """Train; whatever ends it early comes with how to go on."""
        out, world = recorder.folder, {"name": self.world, "options": options}
        saved = Checkpoints(out / CHECKPOINTS, identity(agent, world=world))
        every = self.checkpoint_every
        try:
            with recorder, _stopping() as stop:
                if not train(
                    agent, env, self.steps, recorder, saved, checkpoint_every=every, stop=stop
                ):
                    where = f"stopped after decision {agent.n_decisions}"
                    raise StoppedError(stop.signals[0], f"{where}; {_how_to_go_on(out)}")
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted; {_how_to_go_on(out)}") from None
        except OSError as error:
            raise OSError(f"{_sentence(error)}; {_how_to_go_on(out)}") from error

    def _space(self, options: Mapping[str, Any], device: torch.device) -> SensorimotorSpace:
        """Return what the robots do, sense and predict, from a single world."""
        world = _make_world(self.world, 1, options, device)
        try:
            outcomes = self.outcomes or OUTCOMES[self.world]
            return SensorimotorSpace.from_env(world, "all" if outcomes == ("all",) else outcomes)
        finally:
            world.close()

    def _n_recorded(self) -> int:
        """Return of how many agents every decision is recorded; say so if not of all."""
        n_rows = self.agents * self.steps
        if n_rows <= self.recorded_rows or self.agents <= self.recorded_agents:
            return self.agents
        log.info(
            "Decisions are recorded of the first %d robots only, tallies of all: %s rows would be "
            "more than --recorded-rows %s",
            self.recorded_agents,
            f"{n_rows:,}",
            f"{self.recorded_rows:,}",
        )
        return self.recorded_agents

    def _iac(self) -> IACConfig:
        return replace(self.iac, shadows={name: EXPERTS[name]() for name in self.shadows})

    def _description(self, words: Sequence[str], options: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "command": list(words),
            "versions": {"python": platform.python_version(), **{p: version(p) for p in PACKAGES}},
            "world": {"name": self.world, "id": WORLDS[self.world], "options": dict(options)},
            "steps": self.steps,
            "device": self.device,
            "preset": self.preset,
            "iac": self._iac().to_json(),
        }


@dataclass(frozen=True)
class Resume:
    """Go on with a run that was stopped or killed, from its last checkpoint, bit for bit."""

    run_folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    steps: int | None = None
    """How many decisions each robot takes in all; by default as many as when the run began."""

    def __post_init__(self) -> None:
        if self.steps is not None:
            check_count("steps", self.steps)

    def run(self) -> None:
        """Carry the command out."""
        run = load_run(self.run_folder)
        words = run.config.get("command")
        if not isinstance(words, list) or words[:2] != ["torch-iac", "train"]:
            raise ValueError(f"{self.run_folder} must be a run of torch-iac train, got {words}")
        settings = _settings_of([str(word) for word in words[1:]])
        steps = self.steps or run.config["steps"]
        if (self.run_folder / SUMMARY).exists() and steps <= run.n_decisions:
            raise ValueError(
                f"steps must be above the {run.n_decisions} that {self.run_folder} has ended with, "
                f"got {steps}"
            )
        replace(settings, steps=steps).live(self.run_folder, words, resume=True)


@dataclass(frozen=True)
class Compare:
    """Let robots of several variants develop, seed by seed, and report how they differ.

    Words after -- are options of torch-iac train for all runs. The same command, or just the
    folder, goes on with what is not done; more variants or more seeds can be asked for at any time.
    """

    folder: Annotated[Path, tyro.conf.Positional]
    """The folder of all the runs and of the report."""
    variant: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A variant, as "NAME: WORDS", the words being options of torch-iac train; once for each. The
    first is what others are compared with."""
    variants: Path | None = None
    """A JSON file with variants: under each name its words, as a list or as one text."""
    seeds: int | None = None
    """How many robots of each variant; by default as many as before, at first 10."""
    seed: int | None = None
    """Seed of the first robot; each further one has the next. By default as before, at first 0."""
    block: int | None = None
    """How many robots of a variant are one run, as a population (for the kinematic world); by
    default as before, at first 1."""
    processes: int = field(default_factory=lambda: os.cpu_count() or 1)
    """How many runs go on at once on this machine; by default one for each core."""
    ray: str | None = None
    """The address of a Ray cluster that shall carry the runs out instead, or auto."""
    gpus: float = 0.0
    """Which part of a GPU each run gets on Ray."""
    only: str | None = None
    """Only part I of N of the runs, written I/N, and no report: for the tasks of an array job."""

    report: bool = False
    """Only report on what has ended."""

    def run(self, words: Sequence[str]) -> None:
        """Carry the command out; `words` are options for all runs."""
        comparison = self._comparison(words)
        if not self.report:
            self._carry_out(comparison)
        self._answer(comparison)

    def _carry_out(self, comparison: Comparison) -> None:
        """Carry out the runs that are not done."""
        jobs = comparison.jobs()
        sizes = self._sizes(jobs)
        open_jobs = [job for job in self._part(jobs) if job.state != "done"]
        if self.ray is None:
            crew = on_processes(open_jobs, go_on, self.processes)
        else:
            crew = on_ray(open_jobs, go_on, self.ray, self.gpus)
        comparison.save()
        with _stopping() as stop:
            is_over = carry_out({job: sizes[job] for job in open_jobs}, crew, stop)
        if not is_over:
            raise StoppedError(
                stop.signals[0], f"stopped; go on with: torch-iac compare {self.folder}"
            )

    def _answer(self, comparison: Comparison) -> None:
        """Report, and say where, and which runs failed."""
        mine = self._part(comparison.jobs())
        lines = [f"{len(mine)} run{'s' if len(mine) != 1 else ''}: {tally_states(mine)}."]
        if self.only is None and any(job.state == "done" for job in mine):
            lines.append(f"Read {save_report(comparison)}, or: tensorboard --logdir {self.folder}")
        print("\n".join(lines))  # noqa: T201 - the command's answer
        failed = [job for job in mine if job.state == "failed"]
        if failed:
            _exit(1, "\n".join(f"{job.name} failed: {job.reason}" for job in failed))

    def _part(self, jobs: Sequence[Job]) -> Sequence[Job]:
        """Return the runs that this command is about."""
        return part_of(jobs, self.only) if self.only else jobs

    def _comparison(self, words: Sequence[str]) -> Comparison:
        """Return what the folder holds, if anything, and what is asked for besides."""
        check_count("processes", self.processes)
        given = read_variants(self.variants) if self.variants else ()
        given += tuple(Variant.from_text(text) for text in self.variant)
        numbers = {"n_seeds": self.seeds, "seed": self.seed, "block": self.block}
        folder = self.folder.absolute()  # where the workers are, another may be the present one
        if (folder / PLAN).exists():
            return load_comparison(folder).grown(given, words, **numbers)
        asked = {name: number for name, number in numbers.items() if number is not None}
        return Comparison(folder, given, tuple(words), **asked)

    def _sizes(self, jobs: Sequence[Job]) -> dict[Job, int]:
        """Return how many decisions the robots of each run take together, if all can be run.

        Raises:
            ValueError: One cannot; the message names its variant.
        """
        steps = {}
        for job in {job.variant: job for job in jobs}.values():
            try:
                settings = _settings_of(list(job.words[1:]))
                settings.check(elsewhere=self.ray is not None)
            except (ValueError, gym.error.Error) as error:
                raise ValueError(f"variant {job.variant}: {error}") from None
            steps[job.variant] = settings.steps
        for job in jobs:
            job.check()
        return {job: steps[job.variant] * len(job.seeds) for job in jobs}


def go_on(words: Sequence[str], folder: Path) -> None:
    """Begin a run of a comparison, or go on with it if it has begun.

    Raises:
        KeyboardInterrupt: It was asked to stop, and has saved itself.
    """
    settings = _settings_of(list(words[1:]))
    try:
        settings.live(folder, words, resume=folder.exists())
    except StoppedError as stopped:
        raise KeyboardInterrupt(str(stopped)) from None


def _settings_of(arguments: Sequence[str]) -> Train:
    """Return what `torch-iac train` makes of its options.

    Raises:
        ValueError: They are refused.
    """
    try:
        with redirect_stdout(io.StringIO()):
            settings = _parsed(arguments)
    except SystemExit:
        raise ValueError("words must be options of torch-iac train, got --help") from None
    assert isinstance(settings, Train)  # noqa: S101 - tells the type checker
    return settings


@dataclass(frozen=True)
class Figures:
    """Draw figures 2 and 3 of the paper for a run, into its folder."""

    run_folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    pdf: bool = False
    """Also write each figure as a vector graphic."""

    def run(self) -> None:
        """Carry the command out."""
        for path in save_figures(self.run_folder, pdf=self.pdf):
            print(path)  # noqa: T201 - the command's answer


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command.

    An error that the user can mend is one sentence, with exit code 2; Ctrl-C exits with 130, a
    request to terminate with 143.

    Args:
        arguments: The words after `torch-iac`; those of the command line if none are given.
    """
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        command = _parsed(arguments)
        if isinstance(command, Train):
            command.run(["torch-iac", *arguments])
        elif isinstance(command, Compare):
            command.run(_split(arguments)[1])
        else:
            command.run()
    except (ValueError, OSError, FloatingPointError, gym.error.Error) as error:
        _exit(2, _sentence(error))
    except StoppedError as stopped:
        _exit(128 + stopped.signal, str(stopped))
    except KeyboardInterrupt as interrupt:
        _exit(130, str(interrupt) or "interrupted")


def _exit(code: int, sentence: str) -> NoReturn:
    print(f"torch-iac: {sentence}", file=sys.stderr)  # noqa: T201 - the command's answer
    sys.exit(code)


def _sentence(error: Exception) -> str:
    """Return what an error says, in one line, without the number of the operating system."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(text.split())


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return what stands before -- and what stands after it."""
    words = list(arguments)
    place = words.index("--") if "--" in words else len(words)
    return words[:place], words[place + 1 :]


@plain_refusals()
def _parsed(arguments: Sequence[str]) -> Train | Resume | Compare | Figures:
    settings = (tyro.conf.AvoidSubcommands,)
    if arguments[:1] == ["train"]:
        return tyro.cli(
            Train,
            default=_defaults(arguments),
            prog="torch-iac train",
            args=arguments[1:],
            config=settings,
        )
    if arguments[:1] == ["resume"]:
        return tyro.cli(Resume, prog="torch-iac resume", args=arguments[1:], config=settings)
    if arguments[:1] == ["compare"]:
        own = _split(arguments)[0][1:]
        return tyro.cli(Compare, prog="torch-iac compare", args=own, config=settings)
    if arguments[:1] == ["figures"]:
        return tyro.cli(Figures, prog="torch-iac figures", args=arguments[1:], config=settings)
    return tyro.cli(  # says which commands there are
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Resume, tyro.conf.subcommand("resume")]
        | Annotated[Compare, tyro.conf.subcommand("compare")]
        | Annotated[Figures, tyro.conf.subcommand("figures")],
        prog="torch-iac",
        description="Intelligent Adaptive Curiosity: robots that seek what they learn fastest.",
        args=arguments,
    )


def _defaults(arguments: Sequence[str]) -> Train:
    """Return what the choice of preset and of parts makes of the other options."""
    parser = ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for name in ("preset", "experts", "drive", "choice"):
        parser.add_argument(f"--{name}", nargs="?")  # tyro will say if the value is missing
    parser.add_argument("--no-mp", action="store_true")
    chosen = vars(parser.parse_known_args(arguments)[0])
    preset = PRESETS.get(chosen["preset"] or Train.preset, IACConfig())
    numbers = {f.name: getattr(preset, f.name) for f in fields(preset)}
    if not chosen["no_mp"]:
        numbers["meta"] = MetaPredictor()
    for name, kinds in (("experts", EXPERTS), ("drive", DRIVES), ("choice", CHOICES)):
        if chosen[name] in kinds:
            numbers[name] = kinds[chosen[name]]()
    if "improvement" in numbers["drive"].needs:
        numbers["improvement"] = ImprovementPredictor()
    return Train(iac=Settings(**numbers))


def _make_world(
    name: str, n_worlds: int, options: Mapping[str, Any], device: torch.device
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return as many worlds as asked for, on the device if they are tensors.

    Raises:
        ValueError: The world has no such option, or refuses its value.
    """
    spec = gym.spec(WORLDS[name])
    is_batched = spec.vector_entry_point is not None
    entry = spec.vector_entry_point if is_batched else spec.entry_point
    parameters = signature(load_env_creator(str(entry))).parameters
    allowed = [parameter for parameter in parameters if parameter not in ("num_envs", "device")]
    for option, value in options.items():
        if option not in allowed:
            raise ValueError(f"options of {name} must be among {', '.join(allowed)}, got {option}")
        kind = parameters[option].annotation
        if kind in KINDS and not _is_a(kind, value):
            raise ValueError(f"{option} must be {KINDS[kind]}, got {value!s:.80}")
    if is_batched:
        # Actions are in their bounds; the check would make a GPU wait at every decision.
        options = {"device": device, "check_actions": False, **options}
    way = "vector_entry_point" if is_batched else "sync"
    try:
        with catch_warnings(action="ignore"):  # worlds refuse by themselves what is warned of
            return gym.make_vec(spec.id, n_worlds, way, **options)
    except RuntimeError as error:  # such as a window where there is no display
        raise ValueError(str(error)) from error


def _is_a(kind: Any, value: object) -> bool:
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


def _options(pairs: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of a world, written as name=value, the value in JSON or plain text."""
    options = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not (name and equals):
            raise ValueError(f"world options must be written name=value, got {pair}")
        try:
            options[name.replace("-", "_")] = loads(value)
        except (ValueError, RecursionError):  # not JSON, or more than Python reads of it
            options[name.replace("-", "_")] = value
    return options


class StoppedError(Exception):
    """A command was asked to stop, and did so; the sentence says how to go on."""

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


def _device(name: str) -> torch.device:
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return available_device(name)


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
            f"First cut: {name} at {cuts['median_value']:.2f}, "
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
    lines.append(f"Look at {run.folder / 'figures'}, or: tensorboard --logdir {run.folder.parent}")
    return "\n".join(lines)


def _share(count: Mapping[str, Any], run: Run) -> str:
    return "" if run.n_agents == 1 else f" (median; {count['n_agents']} of {run.n_agents} robots)"
