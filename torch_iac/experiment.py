"""An experiment: everything that is needed to make a run, and to make it again."""

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Self

import torch

from torch_iac.agent import IAC
from torch_iac.analysis.generalisation import record_tests, sets_aside
from torch_iac.config import IACConfig
from torch_iac.experts.hybrid import HybridExperts
from torch_iac.experts.knn import KNNExperts
from torch_iac.experts.network import MLPExperts
from torch_iac.internal.devices import available_device
from torch_iac.internal.files import parse_json
from torch_iac.internal.parts import build, make_importable
from torch_iac.internal.processor import described, processor, rounds_alike
from torch_iac.internal.validation import check_count, jsonable, settle
from torch_iac.memory_estimate import check_memory, check_world_memory
from torch_iac.runs.buffer import recording_bytes
from torch_iac.runs.checkpoint import Checkpoints, identity
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.recorder import KEYS, Recorder
from torch_iac.runs.schema import CHECKPOINTS, CONFIG, SUMMARY
from torch_iac.space import Dimension, SensorimotorSpace
from torch_iac.toy_room import OTHER_WORLD_BYTES, OUTCOMES, WORLD_BYTES, WORLDS
from torch_iac.training import CHECKPOINT_EVERY, train
from torch_iac.worlds.bounds import BOUNDS_FROM, Bounds, bounds_of, recorded_bounds
from torch_iac.worlds.encoders import CONVOLUTION, check_encoder
from torch_iac.worlds.make import make_world, refusals_at_reset
from torch_iac.worlds.spaces import LEFT_OUT
from torch_iac.worlds.vector import World

SEEDS = 2**32
"""Seeds lie below this, so that every random number generator accepts them."""

MOST_SEEDS = 1_000_000
"""Limit of robots in one run; more fit into no memory."""

MOST_HOLD, MOST_BOUNDS_FROM = 1000, 1_000_000
"""Limits: with more, a decision, or the search for bounds, would take minutes."""

THREADED_AGENTS = 32
"""With fewer robots, tensors are so small that sharing work between threads costs time."""

CONFIG_KEY, BOUNDS, MADE_IN, COMMAND = "iac", "bounds", "made_in", "command"
"""Keys in config.json of the config, of bounds that are not the world's own, of the current folder
when the run was made and of the command."""

log = logging.getLogger(__name__)


class StoppedError(Exception):
    """A run was asked to stop, and has saved its state.

    Attributes:
        folder: The run folder.
        n_decisions: How many decisions each robot has taken.
    """

    def __init__(self, folder: Path, n_decisions: int) -> None:
        super().__init__(f"stopped after decision {n_decisions}; {how_to_go_on(folder)}")
        self.folder, self.n_decisions = folder, n_decisions


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Robots in worlds of their own: everything that is needed to make a run, and to make it again.

    ```python
    experiment = Experiment(world="kinematic", config=IACConfig(experts=MLPExperts()), steps=2_000)
    run = experiment.run("runs/a")
    ```

    Raises:
        ValueError: A value is out of its range, or a part of a user's own cannot be imported again
            by its name; the message says the rule and the value.
    """

    world: str = "toyroom"
    """The environment: toyroom, simulated by pybullet; kinematic, the same room in plain
    arithmetic, for thousands of robots at once; or an id of Gymnasium, such as Pendulum-v1
    or module:id."""
    config: IACConfig = field(default_factory=IACConfig)
    """The numbers of the algorithm."""
    seeds: Sequence[int] = (0,)
    """The seed of each robot, and of its world."""
    steps: int = 10_000
    """How many decisions each robot takes."""
    device: str = "cpu"
    """Device of the robots and of the kinematic world: cpu, cuda, cuda:1, ... or auto (cuda if
    there is one)."""
    outcomes: Sequence[str] = ()
    """The sensors to predict, or all; by default what the paper predicts in the toy room, and all
    elsewhere."""
    world_options: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the world, by name."""
    hold: int = 1
    """For how many steps of the world each action is held."""
    encoder: str = CONVOLUTION
    """What makes sensors of pictures: convolution, a fixed random one; pixels, each of which is
    then a sensor; or module:Name, a torch.nn.Module of your own."""
    sensor_bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Low and high bounds of sensors, in raw units; readings beyond are clipped."""
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

    def __post_init__(self) -> None:
        self._settle()
        for name in ("steps", "log_every", "checkpoint_every", "recorded_agents"):
            check_count(name, getattr(self, name))
        for name, most in (("hold", MOST_HOLD), ("bounds_from", MOST_BOUNDS_FROM)):
            if not 1 <= getattr(self, name) <= most:
                raise ValueError(f"{name} must lie in [1, {most:,}], got {getattr(self, name)}")
        for name in ("recorded_rows", "test_every"):
            check_count(name, getattr(self, name), least=0)
        check_encoder(self.encoder)
        if self.test_every and self.world not in WORLDS:
            raise ValueError(
                f"test_every must be 0 outside of the toy rooms, got {self.test_every}"
            )
        if not self.seeds:
            raise ValueError("seeds must name at least one robot, got none")
        for seed in (min(self.seeds), max(self.seeds)):
            if not 0 <= seed < SEEDS:
                raise ValueError(f"seed must lie in [0, {SEEDS}), got {seed}")
        IACConfig.from_json(self.config.to_json())  # refuses what cannot be made again

    def _settle(self) -> None:
        """Let every field hold what its annotation says."""
        if isinstance(self.seeds, Sized) and len(self.seeds) > MOST_SEEDS:
            raise ValueError(f"seeds must be at most {MOST_SEEDS:,}, got {len(self.seeds):,}")
        object.__setattr__(self, "world_options", jsonable("world_options", self.world_options))
        settle(self)
        for name, bounds in self.sensor_bounds.items():
            Dimension(name, *bounds)  # refuses invalid bounds

    def to_json(self) -> dict[str, Any]:
        """Return all fields as JSON can hold them."""
        content = {f.name: getattr(self, f.name) for f in fields(Experiment)}
        content |= {"seeds": list(self.seeds), "outcomes": list(self.outcomes)}
        content |= {"world_options": dict(self.world_options)}
        content |= {"sensor_bounds": {name: list(b) for name, b in self.sensor_bounds.items()}}
        del content["config"]
        return {**content, CONFIG_KEY: self.config.to_json()}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Self:
        """Return the experiment of which `to_json` made JSON; what is missing has its default.

        Parts of a user's own are imported.

        Raises:
            ValueError: There is no such field, or it takes no such value; the message names it.
        """
        if not isinstance(content, Mapping):
            raise ValueError(f"an experiment must have fields by name, got {content!r:.80}")
        values = dict(content)
        if CONFIG_KEY in values:
            values["config"] = IACConfig.from_json(values.pop(CONFIG_KEY))
        if isinstance(values.get("sensor_bounds"), Mapping):
            bounds = values["sensor_bounds"]
            values["sensor_bounds"] = {
                name: tuple(of) if isinstance(of, list) else of for name, of in bounds.items()
            }
        experiment: Self = build(cls, values, "experiment")
        return experiment

    @property
    def is_exact(self) -> bool:
        """Whether the run is the same to the bit on every processor of one architecture.

        So it is on the CPU in the toy rooms, with nearest neighbours, with multi-layer
        perceptrons and with both; a world or a network of a user's own may round otherwise.
        """
        experts = (self.config.experts, *self.config.shadows.values())
        known = all(type(of) in (KNNExperts, MLPExperts, HybridExperts) for of in experts)
        return self.torch_device().type == "cpu" and self.world in WORLDS and known

    def torch_device(self) -> torch.device:
        """Return the device by its name; auto is cuda if there is one.

        Raises:
            ValueError: This machine has no such device.
        """
        name = self.device
        if name == "auto":
            name = "cuda" if torch.cuda.is_available() else "cpu"
        return available_device(name)

    def make_world(self, n_worlds: int | None = None, **options: Any) -> World:
        """Return the worlds, with sensors as the world has them.

        Args:
            n_worlds: How many; one for each robot if not given.
            options: Arguments of the world, besides those of the experiment.

        Raises:
            ValueError: The world or one of its options is refused.
        """
        n_worlds = len(self.seeds) if n_worlds is None else n_worlds
        options = {**self.world_options, **options}
        device = self.torch_device()
        return make_world(self.world, n_worlds, options, device, self.hold, self.encoder)

    def reset(self, world: World, seeds: Sequence[int]) -> None:
        """Reset worlds, one from each seed.

        Raises:
            ValueError: It fails, with options of the world that may be why.
        """
        with refusals_at_reset(self.world, self.world_options):
            world.reset(seed=list(seeds))  # type: ignore[arg-type]  # a list is fine

    def world_identity(self) -> dict[str, Any]:
        """Return what makes the world what it is."""
        content: dict[str, Any] = {"name": self.world, "options": dict(self.world_options)}
        if self.hold > 1:
            content["hold"] = self.hold
        if self.encoder != CONVOLUTION:
            content["encoder"] = self.encoder
        return content

    def check(self, elsewhere: bool = False) -> None:
        """Refuse what the world refuses, and, unless it runs elsewhere, a device that is missing.

        Args:
            elsewhere: Whether the run will be on another machine, with devices of its own.

        Raises:
            ValueError: It is refused.
        """
        here = replace(self, device="cpu") if elsewhere else self
        world, _ = here.bounded_world(n_worlds=1)
        try:
            here.reset(world, here.seeds[:1])
            here.space_of(world)
        finally:
            world.close()

    def space_of(self, world: World) -> SensorimotorSpace:
        """Return what the robots do, sense and predict in their worlds.

        Raises:
            ValueError: No space can be made of the world.
        """
        outcomes = self.outcomes or OUTCOMES.get(self.world, ("all",))
        return SensorimotorSpace.from_env(world, "all" if outcomes == ("all",) else outcomes)

    def bounded_world(
        self, n_worlds: int | None = None, bounds: Bounds | None = None
    ) -> tuple[World, Bounds | None]:
        """Return the worlds with bounds for all sensors, and those that are not the world's own.

        Args:
            n_worlds: How many; one for each robot if not given.
            bounds: Those that an earlier part of the run found.

        Raises:
            ValueError: The world or the bounds that were given are refused.
        """
        world = self.make_world(n_worlds)
        try:
            if bounds is None:
                bounds = bounds_of(
                    world, self.sensor_bounds, self.bounds_from, lambda: self.make_world(1)
                )
            return (world if bounds is None else bounds.clip(world)), bounds
        except BaseException:
            world.close()
            raise

    def run(
        self,
        folder: Path | str | None = None,
        *,
        stop: Callable[[], bool] = lambda: False,
        command: Sequence[str] = (),
    ) -> Run:
        """Run the experiment in a new run folder, and return the run.

        The folder holds every decision, every region, TensorBoard's files, checkpoints, a summary
        and the paper's figures. `resume` goes on with what was stopped or killed.

        Args:
            folder: The run folder; by default a new one in runs/, named by the time.
            stop: Asked after each decision whether to save and stop.
            command: The command that asked for it, for `config.json`.

        Raises:
            StoppedError: It was asked to stop, and has saved its state.
            ValueError: Some value is refused; the message says the rule and the value.
            OSError: The folder holds another run, or cannot be written.
            FloatingPointError: A loss is not finite.
        """
        folder = None if folder is None else Path(folder)
        origin = {MADE_IN: str(Path.cwd()), **({COMMAND: list(command)} if command else {})}
        return self._live(folder, None, origin, stop)

    def run_or_resume(self, folder: Path | str, *, stop: Callable[[], bool] = lambda: False) -> Run:
        """Begin the run in a folder, or go on with it if it has begun, and return it.

        Args:
            folder: The run folder, of this experiment if there is one.
            stop: Asked after each decision whether to save and stop.

        Raises:
            StoppedError: It was asked to stop, and has saved its state.
            ValueError: Some value is refused.
        """
        folder = Path(folder)
        if (folder / SUMMARY).exists():
            return load_run(folder)
        if (folder / CONFIG).exists():
            return resume(folder, self.steps, stop=stop)
        # A run that was killed before it wrote its config has left a folder.
        return self._live(folder, None, {MADE_IN: str(Path.cwd())}, stop, resume=folder.exists())

    def _live(
        self,
        folder: Path | None,
        earlier: Run | None,
        origin: Mapping[str, Any],
        stop: Callable[[], bool],
        resume: bool = False,
    ) -> Run:
        """Begin a run, or go on with it.

        Args:
            folder: The run folder; None for a new one.
            earlier: What it holds.
            origin: Where and how it was begun, for `config.json`.
            stop: Asked after each decision whether to save and stop.
            resume: Whether the folder is there already.
        """
        n_agents, device = len(self.seeds), self.torch_device()
        check_world_memory(n_agents, WORLD_BYTES.get(self.world, OTHER_WORLD_BYTES))
        known = None if earlier is None else recorded_bounds(earlier.config)
        with _threads(n_agents):
            world, bounds = self.bounded_world(bounds=known)
            try:
                space = self.space_of(world)
                n_recorded = self._n_recorded() if earlier is None else earlier.n_recorded
                recording = recording_bytes(space, self.config, self.steps, n_recorded)
                check_memory(space, self.config, n_agents, self.steps, device, recording)
                if earlier is None:
                    self._say_what_was_found(world, bounds)
                # A world that cannot begin leaves no run folder.
                self.reset(world, self.seeds)
                agent = IAC(space, self.config, self.seeds, device)
                folder = _new_folder(self.world) if folder is None else folder
                recorder = Recorder(
                    folder,
                    agent,
                    world.metadata.get("zone_names"),
                    {**self.to_json(), **_description(bounds), **origin},
                    log_every=self.log_every,
                    n_recorded=n_recorded,
                    resume=resume,
                )
                self._develop(agent, world, recorder, stop)
            finally:
                world.close()
        from torch_iac.analysis.figures import save_figures  # with matplotlib: slow to import

        save_figures(folder)
        return load_run(folder)

    def _develop(
        self, agent: IAC, world: World, recorder: Recorder, stop: Callable[[], bool]
    ) -> None:
        """Train; errors that end it early say how to go on."""
        folder = recorder.folder
        saved = Checkpoints(folder / CHECKPOINTS, identity(agent, world=self.world_identity()))
        try:
            with recorder:
                if not train(
                    agent,
                    world,
                    self.steps,
                    recorder,
                    saved,
                    checkpoint_every=self.checkpoint_every,
                    stop=stop,
                    after=self.tests(folder),
                ):
                    raise StoppedError(folder, agent.n_decisions)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted; {how_to_go_on(folder)}") from None
        except OSError as error:
            error.add_note(how_to_go_on(folder))
            raise

    def tests(self, folder: Path) -> Callable[[IAC], None]:
        """Return what tests the robots after a decision, if a test is due, and keeps what it finds.

        Args:
            folder: The run folder.
        """
        sets = sets_aside(self.world, self.world_options) if self.test_every else {}

        def test(agent: IAC) -> None:
            if self.test_every and agent.n_decisions % self.test_every == 0:
                record_tests(agent, sets, folder)

        return test

    def _n_recorded(self) -> int:
        """Return of how many agents every decision is recorded; log it if not of all."""
        n_agents = len(self.seeds)
        n_rows = n_agents * self.steps
        if n_rows <= self.recorded_rows or n_agents <= self.recorded_agents:
            return n_agents
        log.info(
            "Decisions are recorded of the first %d robots only, window sums of all: %s rows would "
            "be more than recorded_rows (%s)",
            self.recorded_agents,
            f"{n_rows:,}",
            f"{self.recorded_rows:,}",
        )
        return self.recorded_agents

    def _say_what_was_found(self, world: World, bounds: Bounds | None) -> None:
        for text in world.metadata.get(LEFT_OUT, ()):
            log.info("The robot does not sense %s, which is text", text)
        if bounds is not None and bounds.found:
            share = f"{len(bounds.found)} of {len(bounds.box.low)} sensors"
            log.info("Bounds for %s were found in %s random decisions", share, self.bounds_from)


def resume(
    folder: Path | str, steps: int | None = None, *, stop: Callable[[], bool] = lambda: False
) -> Run:
    """Go on with a run that was stopped or killed, from its last checkpoint, bit for bit.

    Args:
        folder: The run folder.
        steps: How many decisions each robot takes in all; by default as many as when it began.
        stop: Asked after each decision whether to save and stop.

    Returns:
        The whole run.

    Raises:
        FileNotFoundError: The folder holds no run.
        StoppedError: It was asked to stop, and has saved its state.
        ValueError: It is no run of an experiment, or has ended with as many decisions.
    """
    run = load_run(folder)
    experiment = experiment_of(run)
    steps = experiment.steps if steps is None else steps
    if (run.folder / SUMMARY).exists() and steps <= run.n_decisions:
        raise ValueError(
            f"steps must be above the {run.n_decisions} that {run.folder} has ended with, "
            f"got {steps}"
        )
    origin = {name: run.config[name] for name in (MADE_IN, COMMAND) if name in run.config}
    began_on, here = run.config.get("processor"), processor()
    if not rounds_alike(began_on, here, experiment.is_exact):
        log.info(
            "The run began on another kind of processor (%s) than this one (%s): "
            "the last digits may differ from here on",
            *(described(of) for of in (began_on, here)),
        )
    return replace(experiment, steps=steps)._live(run.folder, run, origin, stop, resume=True)


def load_experiment(path: Path | str) -> Experiment:
    """Return the experiment of a run folder, or of a JSON file such as a run's `config.json`.

    Parts of a user's own are imported, from where Python finds modules, from the folder that was
    the current one when the run was made, or from the current one.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It is no experiment; the message says why.
    """
    path = Path(path)
    if path.is_dir():
        return experiment_of(load_run(path))
    try:
        content = parse_json(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} cannot be read: {error}") from None
    return _from_config(content, path)


def load_agent(
    folder: Path | str, n_decisions: int | None = None, device: str | None = None
) -> IAC:
    """Return the robots of a run as they are at its last checkpoint.

    They can predict, say what actions are worth, and go on in your own loop.

    Args:
        folder: The run folder.
        n_decisions: At which checkpoint; by default the last one.
        device: Where they compute; by default that of the run.

    Raises:
        FileNotFoundError: The folder holds no run, or no such checkpoint.
        ValueError: It is no run of an experiment.
    """
    run = load_run(folder)
    experiment = experiment_of(run)
    if device is not None:
        experiment = replace(experiment, device=device)
    agent = IAC(run.space, experiment.config, experiment.seeds, experiment.torch_device())
    world = experiment.world_identity()
    checkpoints = Checkpoints(run.folder / CHECKPOINTS, identity(agent, world=world))
    agent.load_state(checkpoints.read(n_decisions).agent)
    return agent


def experiment_of(run: Run) -> Experiment:
    """Return the experiment of which a run was made.

    Raises:
        ValueError: It was recorded in a loop of the user's own, or its experiment is refused.
    """
    if "world" not in run.config:
        raise ValueError(
            f"{run.folder} must be the run of an experiment (torch-iac train, or Experiment.run), "
            "got one that names no world"
        )
    if isinstance(run.config["world"], Mapping):
        raise ValueError(
            f"{run.folder} must be a run of this version to be made again, got one of an earlier "
            "version, which can be read and drawn only"
        )
    return _from_config(run.config, run.folder)


def _from_config(content: Any, path: Path) -> Experiment:
    """Return the experiment in a `config.json`, ignoring its other keys."""
    names = [CONFIG_KEY if f.name == "config" else f.name for f in fields(Experiment)]
    if not isinstance(content, Mapping):
        raise ValueError(f"{path} must have fields by name, got {content!r:.80}")
    for name in content:
        if name not in (*names, *KEYS, BOUNDS, MADE_IN, COMMAND):
            raise ValueError(f"{path} must have fields among {', '.join(names)}, got {name}")
    for folder in (content.get(MADE_IN), str(Path.cwd())):
        if isinstance(folder, str):
            make_importable(folder)
    try:
        return Experiment.from_json({name: content[name] for name in names if name in content})
    except ValueError as error:
        raise ValueError(f"{path} cannot be made again: {error}") from error


def how_to_go_on(folder: Path) -> str:
    """Return in words how a run that was stopped goes on."""
    return f"go on with: torch-iac resume {folder}"


def _new_folder(world: str) -> Path:
    """Make and return a run folder in runs/, named by the time and the world.

    It is made at once, so that of two runs that begin in the same second each has its own.
    """
    world = re.sub(r"[^\w.-]", "-", world)
    name = f"{datetime.now():%Y%m%d-%H%M%S}-{world}"
    folder, attempt = Path("runs") / name, 1
    while True:
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            attempt += 1
            folder = Path("runs") / f"{name}-{attempt}"
        else:
            return folder


def _description(bounds: Bounds | None) -> dict[str, Any]:
    """Return what config.json holds besides the experiment."""
    if bounds is None:
        return {}
    return {BOUNDS: {"given": list(bounds.given), "found": list(bounds.found)}}


@contextmanager
def _threads(n_agents: int) -> Iterator[None]:
    """Use one thread for few robots."""
    before = torch.get_num_threads()
    if n_agents < THREADED_AGENTS:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        with suppress(RuntimeError):
            torch.set_num_threads(before)
