"""Options of all commands but `torch-iac train`; parsing them does not import PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from torch_iac.cli.parser import POSITIONAL, REPEATED, Parser, sentence_of, with_values
from torch_iac.internal.cores import n_cores
from torch_iac.internal.validation import check_count
from torch_iac.replay.length import N_DECISIONS


@dataclass(frozen=True)
class Resume:
    """Go on with a run that was stopped or killed, from its last checkpoint, bit for bit.

    Raises:
        ValueError: `steps` is below 1 or too large.
    """

    run_folder: Annotated[Path, POSITIONAL]
    """The run folder."""
    steps: int | None = None
    """How many decisions each robot takes in all; by default as many as when the run began."""

    def __post_init__(self) -> None:
        if self.steps is not None:
            check_count("steps", self.steps)


@dataclass(frozen=True)
class Compare:
    """Let robots of several variants develop, seed by seed, and report how they differ.

    Options after -- are options of torch-iac train for all runs. The same command, or just the
    folder, goes on with what is not done; more variants or more seeds can be asked for at any time.
    """

    folder: Annotated[Path, POSITIONAL]
    """The folder of all the runs and of the report."""
    variant: Annotated[tuple[str, ...], REPEATED] = ()
    """A variant, as "NAME: WORDS", the words being options of torch-iac train; once for each. The
    others are compared with the first."""
    variants: Path | None = None
    """A JSON file with variants: under each name its options, as a list or as one text."""
    seeds: int | None = None
    """How many robots of each variant; by default as many as before, at first 10."""
    seed: int | None = None
    """Seed of the first robot; each further one has the next. By default as before, at first 0."""
    block: int | None = None
    """How many robots of a variant are one run, as a population (for the kinematic world); by
    default as before, at first 1."""
    processes: int = field(default_factory=n_cores)
    """How many runs go on at once on this machine; by default one for each core that this
    process may use."""
    ray: str | None = None
    """The address of a Ray cluster to use instead, or auto."""
    gpus: float = 0.0
    """Fraction of a GPU that each run gets on Ray."""
    only: str | None = None
    """Only part I of N of the runs, written I/N, and no report: for the tasks of an array job."""

    report: bool = False
    """Only report on what has ended."""


@dataclass(frozen=True)
class Figures:
    """Draw a run into its folder: the paper's figures 2 and 3, and errors of shadows and of MP."""

    run_folder: Annotated[Path, POSITIONAL]
    """The run folder."""
    pdf: bool = False
    """Also write each figure as a vector graphic."""


@dataclass(frozen=True)
class Replay:
    """Film a robot of a run at stages of its development, with what it predicts and learns.

    Its world is made again, and its recorded actions are repeated.

    Raises:
        ValueError: `decisions` is below 1 or too large.
    """

    run_folder: Annotated[Path, POSITIONAL]
    """The run folder."""
    at: tuple[int, ...] = ()
    """Decisions from which on to film; by default the beginning, the first focus on f3 and on f2,
    and the end."""
    decisions: int = N_DECISIONS
    """How many decisions from each of them on."""
    agent: int = 0
    """Which robot of a population."""
    out: Path | None = None
    """The film: .mp4, or .gif for a small one; by default figures/replay.mp4 in the run folder."""

    def __post_init__(self) -> None:
        check_count("decisions", self.decisions)


@dataclass(frozen=True)
class Export:
    """Write a run for the Rerun viewer, or as a Minari data set."""

    run_folder: Annotated[Path, POSITIONAL]
    """The run folder."""
    rerun: Path | None = None
    """A file for the Rerun viewer, .rrd: world, robot, beams, toy, regions and progress over
    time."""
    minari: str | None = None
    """A Minari data set of all transitions: a name, such as toyroom/curious-v0, or a folder that
    begins with / or ./ and ends so, too."""
    agent: int = 0
    """Which robot of a population goes into the file for Rerun."""

    def __post_init__(self) -> None:
        check_count("agent", self.agent, least=0)


Options = Resume | Compare | Figures | Replay | Export
"""The parsed options of any of these commands."""

KINDS: dict[str, type[Options]] = {
    "resume": Resume,
    "compare": Compare,
    "figures": Figures,
    "replay": Replay,
    "export": Export,
}
"""The commands by name."""


USAGE = {
    "resume": "RUN_FOLDER [OPTION ...]",
    "compare": "FOLDER [OPTION ...] [-- OPTION_OF_TRAIN ...]",
    "figures": "RUN_FOLDER [OPTION ...]",
    "replay": "RUN_FOLDER [OPTION ...]",
    "export": "RUN_FOLDER [OPTION ...]",
}
"""Usage of each command, after its name."""


def parse(words: Sequence[str]) -> Options:
    """Parse the options of one of these commands; help ends the program.

    Args:
        words: The command's name and its options.

    Raises:
        ValueError: A word is refused.
    """
    name, *options = words
    kind = KINDS[name]
    parser = Parser(f"torch-iac {name}", USAGE[name], sentence_of(kind))
    defaults = kind(Path())
    parser.add_options(defaults)
    values = parser.read(split_at_dashes(options)[0] if name == "compare" else options)
    return with_values(defaults, values)


def split_at_dashes(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return what stands before -- and what stands after it."""
    words = list(words)
    place = words.index("--") if "--" in words else len(words)
    return words[:place], words[place + 1 :]
