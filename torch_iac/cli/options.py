"""What `torch-iac train` can be told: its options, their defaults, and what follows from them."""

import io
import logging
import platform
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from contextlib import closing, redirect_stdout
from dataclasses import dataclass, field, fields, replace
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import tyro

from torch_iac.cli.parser_errors import plain_refusals
from torch_iac.config import PRESETS, IACConfig
from torch_iac.drives.baselines import Error, Improvement, Novelty, Random
from torch_iac.drives.choices import Choice, Greedy, Proportional, Softmax
from torch_iac.drives.curriculum import Curriculum
from torch_iac.drives.learning_progress import (
    AbsoluteProgress,
    GlobalProgress,
    MetaProgress,
    Progress,
)
from torch_iac.drives.protocol import Drive
from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.network import MLPExperts
from torch_iac.experts.protocol import Experts
from torch_iac.internal.devices import available_device
from torch_iac.internal.processor import processor
from torch_iac.internal.validation import check_count
from torch_iac.meta_predictor import ImprovementPredictor, MetaPredictor
from torch_iac.runs.reader import Run
from torch_iac.space import SensorimotorSpace
from torch_iac.toy_room import OUTCOMES, WORLDS
from torch_iac.training import CHECKPOINT_EVERY
from torch_iac.worlds.bounds import Bounds, bounds_of, parse_bounds
from torch_iac.worlds.make import make_world
from torch_iac.worlds.options import parse_options
from torch_iac.worlds.vector import World

EXPERTS: dict[str, type[Experts]] = {"knn": KNNExperts, "mlp": MLPExperts}
"""What the kinds of experts are called."""
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
"""What the drives are called."""
CHOICES: dict[str, type[Choice]] = {
    "greedy": Greedy,
    "proportional": Proportional,
    "softmax": Softmax,
}
"""What the choices are called."""
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
"""The same names, for the parser."""

SEEDS = 2**32
"""Seeds lie below; every random number generator takes them."""

MOST_HOLD, MOST_BOUNDS_FROM = 1000, 1_000_000
"""Beyond use: a decision, or what comes before the first, would take minutes."""

PACKAGES = ("torch_iac", "torch", "numpy", "gymnasium", "pybullet", "pybullet-arm64", "mujoco")
"""What config.json tells the versions of."""

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
    """No option here: `Train` has it."""


@dataclass(frozen=True)
class Train:
    """Let robots develop in a world and write down what they do.

    The run folder holds every decision, every region, TensorBoard's files, a summary and the
    paper's figures.

    Raises:
        ValueError: A number is out of its range; the message names it, the rule and the value.
    """

    world: str = "toyroom"
    """Where the robots live: toyroom, simulated by pybullet; kinematic, its twin in plain
    arithmetic, for thousands of robots at once; or what Gymnasium calls a world, such as
    Pendulum-v1 or module:id."""
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
    """The sensors to predict, or all; by default what the paper predicts in the toy room, and all
    elsewhere."""
    world_options: tuple[str, ...] = ()
    """Arguments of the world, such as beams=4 sensor_noise=0."""
    hold: int = 1
    """For how many steps of the world each action is held."""
    sensor_bounds: tuple[str, ...] = ()
    """Bounds of sensors, such as sensor_4=-10,10; what reads beyond is taken for the bound."""
    bounds_from: int = 1000
    """Sensors that have no bounds get those of what they read in so many random decisions, and a
    tenth more on either side."""
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
    """The engine's numbers."""

    def __post_init__(self) -> None:
        for name in ("steps", "agents", "log_every", "checkpoint_every", "recorded_agents"):
            check_count(name, getattr(self, name))
        for name, most in (("hold", MOST_HOLD), ("bounds_from", MOST_BOUNDS_FROM)):
            if not 1 <= getattr(self, name) <= most:
                raise ValueError(f"{name} must lie in [1, {most:,}], got {getattr(self, name)}")
        check_count("recorded_rows", self.recorded_rows, least=0)
        if not 0 <= self.seed < SEEDS:
            raise ValueError(f"seed must lie in [0, {SEEDS}), got {self.seed}")

    def check(self, elsewhere: bool = False) -> None:
        """Refuse what the world refuses, and a device that is not here, unless it is elsewhere.

        Args:
            elsewhere: Whether the run will be on another machine, with devices of its own.

        Raises:
            ValueError: It is refused.
        """
        settings = replace(self, device="cpu") if elsewhere else self
        settings.space(settings.bounds())

    def bounds(self) -> Bounds | None:
        """Return what the sensors are clipped to; None if the world has bounds of its own.

        The world is begun once: one that cannot be is known before there is a run.

        Raises:
            ValueError: The world or the bounds that were given are refused.
        """
        with closing(self.make_world(1)) as world:
            world.reset(seed=self.seed)
            return bounds_of(world, parse_bounds(self.sensor_bounds), self.bounds_from)

    def space(self, bounds: Bounds | None) -> SensorimotorSpace:
        """Return what the robots do, sense and predict, from a single world with these bounds.

        Raises:
            ValueError: The world is refused, or no space can be made of it.
        """
        outcomes = self.outcomes or OUTCOMES.get(self.world, ("all",))
        with closing(self.make_world(1, bounds)) as world:
            return SensorimotorSpace.from_env(world, "all" if outcomes == ("all",) else outcomes)

    def make_world(self, n_worlds: int, bounds: Bounds | None = None) -> World:
        """Return as many worlds as asked for, with these bounds for sensors.

        Raises:
            ValueError: The world or one of its options is refused.
        """
        options, device = self.parsed_options(), self.torch_device()
        return make_world(self.world, n_worlds, options, device, self.hold, bounds)

    def world_identity(self) -> dict[str, Any]:
        """Return what makes the world what it is."""
        held = {"hold": self.hold} if self.hold > 1 else {}
        return {"name": self.world, "options": self.parsed_options(), **held}

    def config(self) -> IACConfig:
        """Return the engine's numbers, with the shadows."""
        return replace(self.iac, shadows={name: EXPERTS[name]() for name in self.shadows})

    def torch_device(self) -> torch.device:
        """Return the device by its name; auto is cuda if there is one.

        Raises:
            ValueError: This machine has no such device.
        """
        name = self.device
        if name == "auto":
            name = "cuda" if torch.cuda.is_available() else "cpu"
        return available_device(name)

    def parsed_options(self) -> dict[str, Any]:
        """Return the arguments of the world by name.

        Raises:
            ValueError: One is not written name=value.
        """
        return parse_options(self.world_options)

    def is_exact(self) -> bool:
        """Return whether the run is the same to the bit on every processor of its architecture.

        So it is on the CPU in the toy rooms, with nearest neighbours and with multi-layer
        perceptrons; a world or a network of a user's may round otherwise.
        """
        of_ours = {EXPERTS[self.experts], *(EXPERTS[name] for name in self.shadows)}
        return (
            self.torch_device().type == "cpu"
            and self.world in WORLDS
            and of_ours <= {KNNExperts, MLPExperts}
        )

    def n_recorded(self) -> int:
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

    def description(self, words: Sequence[str], bounds: Bounds | None) -> dict[str, Any]:
        """Return what `config.json` says of the command; `words` are what the user typed."""
        world = {**self.world_identity(), "id": WORLDS.get(self.world, self.world)}
        if bounds is not None:
            world["bounds"] = {"given": bounds.given, "found": bounds.found}
        return {
            "command": list(words),
            "versions": {"python": platform.python_version(), **_versions()},
            "processor": processor(),
            "world": world,
            "steps": self.steps,
            "device": self.device,
            "preset": self.preset,
            "iac": self.config().to_json(),
        }


def settings_of(arguments: Sequence[str]) -> Train:
    """Return what `torch-iac train` makes of its options, without a word on the screen.

    Raises:
        ValueError: They are refused.
    """
    try:
        with redirect_stdout(io.StringIO()), plain_refusals():
            return parse_train(arguments)
    except SystemExit:
        raise ValueError("words must be options of torch-iac train, got --help") from None


def parse_train(arguments: Sequence[str]) -> Train:
    """Return what `torch-iac train` makes of its options; help and refusals end the program."""
    return tyro.cli(
        Train,
        default=_defaults(arguments),
        prog="torch-iac train",
        args=arguments,
        config=(tyro.conf.AvoidSubcommands,),
    )


def _versions() -> dict[str, str]:
    """Return the versions of what a run depends on, as far as it is installed."""
    return {name: found.version for name in PACKAGES for found in metadata.distributions(name=name)}


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


def words_of(run: Run) -> list[str]:
    """Return the command that a run was begun with.

    Raises:
        ValueError: It was not begun by this command.
    """
    words = run.config.get("command")
    if not isinstance(words, list) or words[:2] != ["torch-iac", "train"]:
        raise ValueError(f"{run.folder} must be a run of torch-iac train, got {words}")
    return [str(word) for word in words]
