"""The options of `torch-iac train`, and the experiment that they describe."""

from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from json import dumps
from pathlib import Path
from typing import Any, Literal

from typing_extensions import TypeIs

from torch_iac.cli.parser import Parser, is_part, sentence_of, with_values
from torch_iac.config import PRESETS, IACConfig
from torch_iac.experiment import MOST_SEEDS, SEEDS, Experiment, load_experiment
from torch_iac.experts.network import NetworkExperts
from torch_iac.internal.validation import check_count
from torch_iac.kinds import KINDS, named
from torch_iac.meta_predictor import ImprovementPredictor, MetaPredictor
from torch_iac.training import CHECKPOINT_EVERY
from torch_iac.worlds.bounds import BOUNDS_FROM, parse_bounds
from torch_iac.worlds.encoders import CONVOLUTION
from torch_iac.worlds.options import parse_options

GROUPS = {
    "what most runs choose": (
        *("world", "experts", "drive", "choice", "steps", "agents", "seed", "out", "device"),
        *("shadows", "mp", "preset", "config"),
    ),
    "world": ("outcomes", "world_options", "hold", "encoder", "sensor_bounds", "bounds_from"),
    "recording": (
        *("log_every", "recorded_rows", "recorded_agents", "checkpoint_every", "test_every"),
    ),
}
"""The options of `Train`, as the help has them."""

PART_FIELDS = ("experts", "drive", "choice", "meta", "improvement")
"""The fields of a config that have options of their own."""


@dataclass(frozen=True)
class Train:
    """Let robots develop in a world and write down what they do.

    The run folder holds every decision, every region, TensorBoard's files, a summary and the
    paper's figures.

    Raises:
        ValueError: A number is out of its range; the message names it, the rule and the value.
    """

    world: str = "toyroom"
    """The environment: toyroom, simulated by pybullet; kinematic, the same room in plain
    arithmetic, for thousands of robots at once; or an id of Gymnasium, such as Pendulum-v1
    or module:id."""
    experts: str = "knn"
    """What predicts in each region: knn, mlp, hybrid (both in each region), or module:Name, experts
    or a network of your own. Its options are among those below."""
    drive: str = "progress"
    """What a candidate action is worth: progress, meta_progress, absolute_progress,
    global_progress, error, novelty, improvement, curriculum, random, or module:Name, a drive of
    your own."""
    choice: str = "greedy"
    """Which candidate action is taken, given what each is worth: greedy, proportional, softmax, or
    module:Name."""
    steps: int = 10_000
    """How many decisions each robot takes."""
    agents: int = 1
    """How many robots, each in a world of its own."""
    seed: int = 0
    """Seed of the first robot; each further one has the next."""
    out: Path | None = None
    """The run folder; by default a new one in runs/, named by the time."""
    device: str = "cpu"
    """Device of the robots and of the kinematic world: cpu, cuda, cuda:1, ... or auto (cuda if
    there is one)."""
    shadows: tuple[str, ...] = ()
    """Other experts, which predict and learn on the same stream without any influence."""
    mp: bool = True
    """Whether the meta-predictor MP learns what errors to expect; some drives need it."""
    preset: Literal["iac2004", "iac2007"] = "iac2004"
    """Which paper's numbers the options start from; they are the defaults shown here."""
    config: Path | None = None
    """A JSON file with an experiment, such as config.json of a run, that the options start from."""
    outcomes: tuple[str, ...] = ()
    """The sensors to predict, or all; by default what the paper predicts in the toy room, and all
    elsewhere."""
    world_options: tuple[str, ...] = ()
    """Arguments of the world, such as beams=4 sensor_noise=0."""
    hold: int = 1
    """For how many steps of the world each action is held."""
    encoder: str = CONVOLUTION
    """What makes sensors of pictures: convolution, a fixed random one; pixels, each of which is
    then a sensor; or module:Name, a torch.nn.Module of your own."""
    sensor_bounds: tuple[str, ...] = ()
    """Bounds of sensors, such as sensor_4=-10,10; readings beyond are clipped."""
    bounds_from: int = BOUNDS_FROM
    """How many random decisions find bounds for sensors without any: the range of their readings,
    and a tenth of it more on either side."""
    log_every: int = 100
    """How many decisions lie between two logs to TensorBoard; more after the first 1,000 logs."""
    recorded_rows: int = 20_000_000
    """Every decision of every robot is recorded if that makes at most so many rows, of about 65
    bytes each on disk; otherwise those of the first robots only, and window sums of all."""
    recorded_agents: int = 64
    """The number of those first robots."""
    checkpoint_every: int = CHECKPOINT_EVERY
    """How many decisions lie between two checkpoints, or more where they would take over a
    twentieth of the time."""
    test_every: int = 0
    """How many decisions lie between two generalisation tests in f2, in the toy rooms; 0 for none.
    Their errors go into the folder generalisation."""
    iac: IACConfig = field(default_factory=IACConfig)
    """The numbers of the algorithm, without shadows."""

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
        shadows = {name: named("experts", name) for name in self.shadows}
        return Experiment(
            **{name: getattr(self, name) for name in _same_fields()},
            config=replace(self.iac, shadows=shadows) if shadows else self.iac,
            seeds=range(self.seed, self.seed + self.agents),
            world_options=parse_options(self.world_options),
            sensor_bounds=parse_bounds(self.sensor_bounds),
        )


def _same_fields() -> set[str]:
    """Return the fields that are the same in `Train` and in `Experiment`.

    Not so `config`, a file there and numbers here, nor those that are texts there and values here.
    """
    names = {f.name for f in fields(Experiment)} & {f.name for f in fields(Train)}
    return names - {"config", "world_options", "sensor_bounds"}


def experiment_of(words: Sequence[str]) -> Experiment:
    """Return the experiment that options of `torch-iac train` describe.

    Raises:
        ValueError: They are refused.
    """
    if {"-h", "--help"} & set(words):
        raise ValueError("words must be options of torch-iac train, got --help")
    return parse_train(words).experiment()


def parse_train(words: Sequence[str]) -> Train:
    """Parse the options of `torch-iac train`; `--help` ends the program.

    Raises:
        ValueError: They are refused.
    """
    start = _start(words)
    parser = Parser("torch-iac train", "[OPTION ...]", sentence_of(Train))
    for title, names in GROUPS.items():
        parser.add_options(start, title, names=names)
    numbers = {f.name for f in fields(IACConfig)} - set(PART_FIELDS)
    parser.add_options(start.iac, "numbers of the algorithm", names=numbers)
    for name in PART_FIELDS:
        value = getattr(start.iac, name)
        if is_part(value):
            parser.add_options(value, f"{name} ({type(value).__name__})", f"{name}.")
        if is_network(value):
            parser.add_options(value.module, f"network ({type(value.module).__name__})", f"{name}.")
    values = parser.read(words)
    config = with_values(start.iac, values)
    if is_network(config.experts):
        network = with_values(config.experts.module, values, "experts.")
        config = replace(config, experts=replace(config.experts, module=network))
    return replace(with_values(start, values), iac=config)


def is_network(experts: Any) -> TypeIs[NetworkExperts]:
    """Return whether experts are networks of a factory with numbers of its own."""
    return isinstance(experts, NetworkExperts) and is_part(experts.module)


def _start(words: Sequence[str]) -> Train:
    """Return the defaults of all options, given the file, the preset and the parts."""
    parser = ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for name in ("config", "preset", *KINDS):
        parser.add_argument(f"--{name}", nargs="?")  # a missing value is refused later
    chosen = vars(parser.parse_known_args(words)[0])
    no_mp = {"--no-mp", "--no_mp"} & set(words)
    start = Train() if chosen["config"] is None else _from_file(Path(chosen["config"]))
    config = PRESETS.get(chosen["preset"], start.iac)
    changes: dict[str, Any] = {
        kind: named(kind, chosen[kind]) for kind in KINDS if chosen[kind] is not None
    }
    if no_mp:
        changes["meta"] = None
    needs = changes.get("drive", config.drive).needs
    if "meta" in needs and config.meta is None and not no_mp:
        changes["meta"] = MetaPredictor()
    if "improvement" in needs and config.improvement is None:
        changes["improvement"] = ImprovementPredictor()
    return replace(start, iac=replace(config, **changes))


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
    bounds = experiment.sensor_bounds.items()
    return Train(
        **{name: getattr(experiment, name) for name in _same_fields()},
        seed=first,
        agents=n_agents,
        world_options=tuple(f"{n}={dumps(of)}" for n, of in experiment.world_options.items()),
        sensor_bounds=tuple(f"{name}={low!r},{high!r}" for name, (low, high) in bounds),
        config=path,
        iac=experiment.config,
        mp=experiment.config.meta is not None,
    )
