"""Does the command work, or say in one sentence why not, whatever is typed?

    python -m scripts.stress.fuzz
    python -m scripts.stress.fuzz --only 123

Random command lines for `torch-iac train`: 10,000 are only parsed, 500 are carried out in a
temporary folder. Options and their kinds are what `--help` says, so new ones are tried by
themselves. A command fails if it raises, hangs, ends with another exit code than 0 or 2, is refused
in more than one line, or works and writes to stderr. Every failing command is printed with its
number, by which `--only` runs it alone.
"""

import contextlib
import faulthandler
import io
import os
import random
import re
import resource
import shlex
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from unittest import mock

import tyro

from torch_iac.cli import dispatch
from torch_iac.cli.main import main as torch_iac
from torch_iac.config import PRESETS
from torch_iac.kinds import KINDS
from torch_iac.toy_room import WORLDS as NAMED_WORLDS

PARTS = {"preset": list(PRESETS), **{kind: list(names) for kind, (names, _) in KINDS.items()}}
"""Options on which others depend, each with its good values."""

WORLDS = list(NAMED_WORLDS)
"""The worlds of this project."""
OTHER_WORLDS = ["Pendulum-v1", "CartPole-v1", "Mars-v0", "mars:Sol-v1", "Pendulum", ":", "a:b:c"]
"""Worlds of Gymnasium, most of which cannot be lived in or do not exist."""

OPTION = re.compile(
    r"(?<![\w-])--([a-z][\w.-]*)(?:, --no-[\w.-]+)? "
    r"(INT|FLOAT|TEXT|PATH|\[\w+ \.\.\.\]|\{[^}]*\})?"
)
MOST_WORDS = 12
MEMORY = 24 * 2**30
"""Address space in bytes, so that a command that takes too much fails instead of the machine."""

WHOLE = ["1", "2", "3", "7", "20", "1_0", " 4 "]
EDGE = ["0", "-1", "+1", "-0", "٣"]
HUGE = [str(10**12), str(2**63), str(2**64 - 1), str(10**30), "9" * 400, "9" * 5000, str(-(10**30))]
REAL = ["0", "1", "0.5", "0.15", "1e-3", "1e-300", "1e300", "-0.0", "-1", "1.0000001", "inf", "NaN"]
TEXT = ["cpu", "auto", "meta", "all", "toy_distance", "wall_0", "sound"]
WRONG = ["", " ", "ten", "nan", "-inf", "1e3", "2.5", "0x10", "None", "true", "[]", "{}", "--", "-"]
STRANGE = ["ü", "模型", "🤖", "\udcff", "a\nb", "a\tb", "%s%n", "'", '"', "x" * 300, "\x1b[31mred"]
UNKNOWN = ["--hunger", "--step", "--k.k", "--iac.epsilon", "-x", "epsilon", "--no-steps", "--="]
PLACES = ["a", "a/b/c", "ü", "", ".", "file", "file/a", "/dev/null", "/proc/nowhere", "x" * 300]
OWN = [
    "torch.nn:Linear",
    "torch:nn",
    "torch:",
    ":Net",
    "nowhere:Net",
    "torch_iac:MLPExperts",
    "os:sep",
]
"""Parts of a user's own, most of which are none."""
JSON = ["0", "1", "4", "-1", "0.02", "1e999", "NaN", "true", "null", '"a"', "[1]", "{}", "[" * 9999]


@dataclass(frozen=True)
class Study:
    """What is tried."""

    parsed: int = 10_000
    """How many command lines are only parsed."""
    lived: int = 500
    """How many are lived through."""
    seed: int = 0
    """Seeds the command lines."""
    only: int | None = None
    """The number of a single command to run alone."""
    seconds: int = 60
    """How long one command may take."""


@dataclass(frozen=True)
class Answer:
    """What came of a command line.

    Attributes:
        kind: `works`, `refused`, or in what way it failed.
        detail: The sentence, or the traceback.
    """

    kind: str
    detail: str

    @property
    def is_failure(self) -> bool:
        """Whether the command did neither work nor say why not."""
        return self.kind not in ("works", "refused")


class Hanging(BaseException):
    """A command takes too long; no handler of errors may take it for one."""


def main() -> None:
    """Try commands and tell what came of them."""
    study = tyro.cli(Study, description=__doc__)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    numbers = range(study.parsed + study.lived) if study.only is None else [study.only]
    failures = 0
    counts: dict[str, Counter[str]] = {"parsed": Counter(), "lived": Counter()}
    for number in numbers:
        is_lived = number >= study.parsed
        words = command(study.seed, number, is_lived)
        answer = answer_to(words, is_lived, study.seconds)
        counts["lived" if is_lived else "parsed"][answer.kind] += 1
        if answer.is_failure or study.only is not None:
            failures += answer.is_failure
            print(f"\n{number}: {answer.kind}: {_line(words)}\n{answer.detail}", flush=True)
    for way, kinds in counts.items():
        print(f"{way}: {', '.join(f'{n:,} {kind}' for kind, n in kinds.most_common())}")
    sys.exit(1 if failures else 0)


def command(seed: int, number: int, is_lived: bool) -> list[str]:
    """Return the words of a random command line, always the same for the same seed and number."""
    rng = random.Random(f"{seed}/{number}")
    parts = tuple(_parts(rng))
    known = options(parts)
    words = [*parts, *(["--no-mp"] if rng.random() < 0.1 else [])]
    if is_lived:
        world = rng.choice(WORLDS)
        words += ["--steps", str(rng.choice([1, 2, 7, 40])), "--world", world]
        if rng.random() < 0.2:
            words += ["--world-options", _world_option(rng, world)]
        words += rng.choice([[], ["--agents", rng.choice(["1", "2", "3"])]])
        if rng.random() < 0.3:  # regions split
            words += ["--max-examples", rng.choice(["2", "3", "8"])]
    share = rng.choice([1.0, 1.0, 0.95, 0.5, 0.0])  # of good values
    for _ in range(rng.choice([0, 1, 1, 2, 3, MOST_WORDS])):
        words += _word(rng, known, share)
    if rng.random() < 0.02 and words:
        del words[rng.randrange(len(words))]
    if is_lived and "--out" not in words:
        words += ["--out", "a"]
    return ["train", *words]


def answer_to(words: Sequence[str], is_lived: bool, seconds: int) -> Answer:
    """Return what comes of a command, lived through in a folder of its own or only parsed."""
    unlived = mock.patch.object(dispatch, "train")
    with contextlib.nullcontext() if is_lived else unlived, _own_folder(), _limit(seconds):
        try:
            code, out, err = _typed(words)
            left = [str(path) for path in Path().rglob("*")]
        except Hanging:
            return Answer("hangs", traceback.format_exc(limit=-6))
        except BaseException:  # every way in which a command may fail is wanted
            return Answer("raises", traceback.format_exc(limit=-8))
    lines = err.splitlines()
    if code == 0:
        return Answer("works, but complains", err) if lines else Answer("works", out)
    if code != 2:
        return Answer(f"ends with {code}", err)
    if len(lines) != 1 or not re.match(r"torch-iac: \S.{8}", lines[0]):
        return Answer("is refused, but not in one sentence", err)
    if left != ["file"] and "at decision" not in err:  # else it lived, and was stopped
        return Answer(f"is refused, but leaves {', '.join(sorted(left))}", err)
    return Answer("refused", err)


@cache
def options(parts: tuple[str, ...]) -> dict[str, str]:
    """Return what `--help` says that there is, given the options of `PARTS`: name and kind."""
    code, text, err = _typed(["train", *parts, "--help"])
    if code != 0:
        raise RuntimeError(f"help must be given, got {err}")
    text = re.sub(r"\s+", " ", text)
    return {name: kind for name, kind in OPTION.findall(text) if name != "help"}


@cache
def world_options(world: str) -> tuple[str, ...]:
    """Return what the command says that a world may be given."""
    _, _, err = _typed(["train", "--world", world, "--world-options", "?=1"])
    found = re.search(r"must be among (.*), got", err)
    if not found:
        raise RuntimeError(f"a refusal must name the options of {world}, got {err}")
    return tuple(found[1].split(", "))


def _parts(rng: random.Random) -> Iterator[str]:
    """Yield good choices of the options on which others depend."""
    for name in PARTS:
        if rng.random() < 0.5:
            yield from (f"--{name}", rng.choice(PARTS[name]))


def _word(rng: random.Random, known: dict[str, str], share: float) -> Iterator[str]:
    """Yield a random option and what follows it."""
    if rng.random() < 0.01:
        yield from (rng.choice(UNKNOWN), rng.choice(WHOLE))
        return
    name = rng.choice([*known, *["world-options"] * 4])
    kind = known[name]
    flag = f"--{name.replace('-', '_')}" if rng.random() < 0.05 else f"--{name}"
    if not kind:  # on or off
        yield flag if rng.random() < 0.5 else f"--no-{name}"
        if rng.random() < 0.05:
            yield "True"
        return
    makers: dict[str, Callable[[], str]] = {
        **dict.fromkeys(("out", "config"), lambda: rng.choice(PLACES)),
        **dict.fromkeys(KINDS, lambda: rng.choice([*PARTS[name], *OWN, *WRONG])),
        "world": lambda: rng.choice([*WORLDS * 4, *OTHER_WORLDS, *STRANGE, *WRONG]),
        "world-options": lambda: _world_option(rng, rng.choice(WORLDS)),
    }
    make = makers.get(name, lambda: _value(rng, kind, share))
    n_values = rng.choice([0, 1, 1, 2, 3]) if kind.startswith("[") else int(rng.random() < 0.98)
    values = [make() for _ in range(n_values)]
    if len(values) == 1 and rng.random() < 0.2:
        yield f"{flag}={values[0]}"
    else:
        yield from (flag, *values)


def _value(rng: random.Random, kind: str, share: float) -> str:
    """Return a value for an option of a kind, such as `INT`; `share` of them are good."""
    good = {"INT": WHOLE, "FLOAT": REAL, "TEXT": TEXT}.get(kind.strip("[ .]").split(" ")[0])
    good = good or _choices(kind)
    if rng.random() < share:
        return rng.choice(good)
    return rng.choice(rng.choice([EDGE, HUGE, WRONG, STRANGE, REAL]))


def _world_option(rng: random.Random, world: str) -> str:
    name = rng.choice([*world_options(world)] * 5 + ["device", "num_envs", "smell", ""])
    value = rng.choice([*JSON, *WHOLE, *HUGE, *STRANGE, "human", "rgb_array"])
    return rng.choice([f"{name}={value}"] * 8 + [name, f"{name}==", value])


def _choices(kind: str) -> list[str]:
    return re.findall(r"[\w]+", kind.partition("}")[0])


def _typed(words: Sequence[str]) -> tuple[int, str, str]:
    """Return the exit code of a command and what it wrote to stdout and stderr."""
    out, err = (
        io.TextIOWrapper(io.BytesIO(), "utf-8", errors) for errors in ("strict", "backslashreplace")
    )
    code = 0
    wide = mock.patch.dict(os.environ, COLUMNS="120")
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), wide:
        try:
            torch_iac(words)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    texts = []
    for stream in (out, err):
        stream.seek(0)
        texts.append(stream.read())
    return code, *texts  # type: ignore[return-value]  # two


@contextlib.contextmanager
def _own_folder() -> Iterator[None]:
    """Go into a temporary folder with one file in it."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("file").write_text("mine")
        yield


@contextlib.contextmanager
def _limit(seconds: int) -> Iterator[None]:
    """Raise `Hanging` after some time, and end the process if even that does not help."""

    def interrupt(*_: object) -> None:
        raise Hanging

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.alarm(seconds)
    faulthandler.dump_traceback_later(2 * seconds, exit=True, file=2)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        faulthandler.cancel_dump_traceback_later()


def _line(words: Sequence[str]) -> str:
    return shlex.join(["torch-iac", *words]).encode("utf-8", "backslashreplace").decode()


if __name__ == "__main__":
    main()
