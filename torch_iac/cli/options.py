"""The options of `torch-iac train`, and the experiment that they describe."""

import io
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from json import dumps
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from torch import nn

from torch_iac.cli.commands import numbers_registry
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
from torch_iac.experiment import MOST_SEEDS, SEEDS, Experiment, load_experiment
from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.network import MLPExperts, NetworkExperts
from torch_iac.experts.protocol import Experts
from torch_iac.internal.parts import import_object, make_importable
from torch_iac.internal.validation import check_count
from torch_iac.meta_predictor import ImprovementPredictor, MetaPredictor
from torch_iac.training import CHECKPOINT_EVERY
from torch_iac.worlds.bounds import parse_bounds
from torch_iac.worlds.options import parse_options

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

KINDS: dict[str, tuple[Mapping[str, type], type]] = {
    "experts": (EXPERTS, Experts),
    "drive": (DRIVES, Drive),
    "choice": (CHOICES, Choice),
}
"""The parts that have a name: the library's own, and what any other must be."""

Plain = tyro.conf.arg(name="")
"""The options of a part are named without the part's own name before theirs."""


@dataclass(frozen=True, kw_only=True)
class Settings(IACConfig):
    """The numbers of the algorithm, as options of the command; `Any` is what the default is."""

    experts: Any = field(default_factory=KNNExperts)
    """What predicts the outcome in each region."""
    network: Annotated[Any, tyro.conf.arg(name="experts")] = None
    """The network of a user's own in each region, if its factory has fields."""
    drive: Any = field(default_factory=Progress)
    """What a candidate action is worth."""
    choice: Any = field(default_factory=Greedy)
    """Which candidate is taken, given what each is worth."""
    shadows: tyro.conf.Suppress[Mapping[str, Experts]] = field(default_factory=dict)
    """No option here: `Train` has it."""

    def config(self, shadows: Mapping[str, Experts]) -> IACConfig:
        """Return the config that they describe."""
        numbers = {f.name: getattr(self, f.name) for f in fields(IACConfig)}
        if self.network is not None:
            numbers["experts"] = replace(self.experts, module=self.network)
        return IACConfig(**{**numbers, "shadows": shadows or numbers["shadows"]})


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
    config: Path | None = None
    """A JSON file with an experiment, such as config.json of a run, that the options start from."""
    experts: str = "knn"
    """What predicts in each region: knn, mlp, or module:Name, experts or a network of your own. Its
    options are among those below."""
    shadows: tuple[str, ...] = ()
    """Other experts, which predict and learn on the same stream without any influence."""
    drive: str = "progress"
    """What the robot wants: progress, meta_progress, absolute_progress, global_progress, error,
    novelty, improvement, curriculum, random, or module:Name, a drive of your own."""
    choice: str = "greedy"
    """Which candidate action is taken, given what each is worth: greedy, proportional, softmax, or
    module:Name."""
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
    bytes each on disk; otherwise those of the first robots only, and window sums of all."""
    recorded_agents: int = 64
    """How many those first robots are."""
    checkpoint_every: int = CHECKPOINT_EVERY
    """How many decisions lie between two checkpoints, or more where they would take over a
    twentieth of the time."""
    test_every: int = 0
    """How many decisions lie between two generalisation tests in f2, in the toy rooms; 0 for none.
    Their errors go into generalisation.parquet."""
    iac: Annotated[Settings, Plain] = field(default_factory=Settings)
    """The numbers of the algorithm."""

    def __post_init__(self) -> None:
        check_count("agents", self.agents)
        if self.agents > MOST_SEEDS:
            raise ValueError(f"agents must be at most {MOST_SEEDS:,}, got {self.agents:,}")
        if not 0 <= self.seed < SEEDS:
            raise ValueError(f"seed must lie in [0, {SEEDS}), got {self.seed}")
        self.experiment()  # refuses what is out of its range

    def experiment(self) -> Experiment:
        """Return the experiment that the options describe.

        Raises:
            ValueError: A number is out of its range.
        """
        names = {f.name for f in fields(Experiment)} & {f.name for f in fields(self)}
        return Experiment(
            **{name: getattr(self, name) for name in names - {"config", *_TEXTS}},
            config=self.iac.config({name: part("experts", name) for name in self.shadows}),
            seeds=range(self.seed, self.seed + self.agents),
            world_options=parse_options(self.world_options),
            sensor_bounds=parse_bounds(self.sensor_bounds),
        )


_TEXTS = ("world_options", "sensor_bounds")
"""What stands as texts in `Train` and as values in `Experiment`."""


def experiment_of(words: Sequence[str]) -> Experiment:
    """Return the experiment that options of `torch-iac train` describe, without any output.

    Raises:
        ValueError: They are refused.
    """
    try:
        with redirect_stdout(io.StringIO()), plain_refusals():
            return parse_train(words).experiment()
    except SystemExit:
        raise ValueError("words must be options of torch-iac train, got --help") from None


def parse_train(words: Sequence[str]) -> Train:
    """Return what `torch-iac train` makes of its options; help and refusals end the program."""
    return tyro.cli(
        Train,
        default=_defaults(words),
        prog="torch-iac train",
        args=words,
        config=(tyro.conf.AvoidSubcommands, tyro.conf.SuppressFixed),
        registry=numbers_registry(),
    )


def part(kind: str, name: str) -> Any:
    """Return a part of a config, with its default numbers, by its name.

    Args:
        kind: Experts, drive or choice.
        name: One of the library's own, or `module:Name`: a class of a user's own; for experts also
            a module or a factory of one, which is then in each region.

    Raises:
        ValueError: There is none of that name, or it is something else.
    """
    known, protocol = KINDS[kind]
    if name in known:
        return known[name]()
    if ":" not in name:
        near = get_close_matches(name, known, 1)
        perhaps = f"; perhaps you meant {near[0]}" if near else ""
        raise ValueError(f"{kind} must be {', '.join(known)} or module:Name, got {name}{perhaps}")
    make_importable(Path.cwd())
    found = import_object(name, kind)
    if kind == "experts" and not hasattr(found, "pool"):
        is_factory = is_dataclass(found) and not issubclass(found, nn.Module)  # type: ignore[arg-type]
        return NetworkExperts(module=_made(found, kind, name) if is_factory else found)
    made = _made(found, kind, name)
    if not isinstance(made, protocol):
        raise ValueError(f"{kind} must have what {protocol.__name__} has, got {name}")
    return made


def _made(found: Callable[[], Any], kind: str, name: str) -> Any:
    """Return an object of a class with its default numbers."""
    try:
        return found() if isinstance(found, type) else found
    except TypeError as error:
        raise ValueError(
            f"{kind} must have defaults for all fields, got {name} ({error})"
        ) from None


def _defaults(words: Sequence[str]) -> Train:
    """Return what the choice of a file, a preset and of parts makes of the other options."""
    parser = ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for name in ("config", "preset", *KINDS):
        parser.add_argument(f"--{name}", nargs="?")  # tyro will say if the value is missing
    parser.add_argument("--no-mp", action="store_true")
    chosen = vars(parser.parse_known_args(words)[0])
    start = Train() if chosen["config"] is None else _from_file(Path(chosen["config"]))
    numbers = {f.name: getattr(start.iac, f.name) for f in fields(Settings)}
    if chosen["preset"] in PRESETS:
        preset = PRESETS[chosen["preset"]]
        numbers |= {f.name: getattr(preset, f.name) for f in fields(preset)}
    if chosen["no_mp"]:
        numbers["meta"] = None
    for name in KINDS:
        if chosen[name] is not None:
            numbers[name] = part(name, chosen[name])
            numbers["network"] = None if name == "experts" else numbers["network"]
    experts = numbers["experts"]
    if isinstance(experts, NetworkExperts) and is_dataclass(experts.module):
        numbers["network"] = experts.module
    if "meta" in numbers["drive"].needs and numbers["meta"] is None and not chosen["no_mp"]:
        numbers["meta"] = MetaPredictor()
    if "improvement" in numbers["drive"].needs and numbers["improvement"] is None:
        numbers["improvement"] = ImprovementPredictor()
    return replace(start, iac=Settings(**numbers))


def _from_file(path: Path) -> Train:
    """Return the options that describe the experiment in a file.

    Raises:
        OSError: It cannot be read.
        ValueError: It holds no experiment, or one whose seeds do not follow each other.
    """
    experiment = load_experiment(path)
    first, n_agents = experiment.seeds[0], len(experiment.seeds)
    if list(experiment.seeds) != list(range(first, first + n_agents)):
        raise ValueError(f"seeds in {path} must follow each other, got {experiment.seeds}")
    names = {f.name for f in fields(Experiment)} & {f.name for f in fields(Train)}
    config = experiment.config
    numbers = {f.name: getattr(config, f.name) for f in fields(config)}
    bounds = experiment.sensor_bounds.items()
    return Train(
        **{name: getattr(experiment, name) for name in names - {"config", *_TEXTS}},
        seed=first,
        agents=n_agents,
        world_options=tuple(f"{n}={dumps(of)}" for n, of in experiment.world_options.items()),
        sensor_bounds=tuple(f"{name}={low!r},{high!r}" for name, (low, high) in bounds),
        config=path,
        iac=Settings(**numbers),
    )
