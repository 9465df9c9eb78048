"""Variants times seeds: the runs of a comparison, their folders and their states.

A comparison is a folder. Its plan holds an experiment for each variant, and says which seeds; a run
is a variant's experiment with some of the seeds.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import join
from tempfile import NamedTemporaryFile
from typing import Any, Literal, Self

from torch_iac.experiment import Experiment
from torch_iac.internal.files import dump_json, parse_json, sync, sync_names
from torch_iac.internal.parts import make_importable
from torch_iac.internal.validation import settle
from torch_iac.runs.reader import Run, load_run
from torch_iac.runs.schema import CONFIG, SUMMARY
from torch_iac.runs.summary import N_AGENTS_LISTED

PLAN = "comparison.json"
"""File of the plan in a comparison's folder."""

FIGURES = "figures"
"""Folder of its pictures; no variant can have this name."""

MOST_SEEDS = 100_000
"""With more, even the list of runs would be too long."""

NAME = re.compile(r"\w[\w.+=-]*")
"""Names that a variant, and so a folder, can have."""

State = Literal["done", "failed", "begun", "open"]
"""State of a run: ended; stopped by an error; begun; not begun."""


@dataclass(frozen=True)
class Variant:
    """What is compared.

    Attributes:
        name: What it is called.
        experiment: What each of its runs is; its seeds are the comparison's.
        words: The options of `torch-iac train` by which it was described, if it was.

    Raises:
        ValueError: The name cannot be a folder's.
    """

    name: str
    experiment: Experiment
    words: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        settle(self)
        if not NAME.fullmatch(self.name) or self.name == FIGURES:
            raise ValueError(
                f"a variant's name must be letters, digits and _.+=-, and not {FIGURES}, "
                f"got {self.name!r}"
            )

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON can hold it, without seeds."""
        content = self.experiment.to_json()
        del content["seeds"]
        return {"words": list(self.words), "experiment": content}

    @classmethod
    def from_json(cls, name: str, content: Mapping[str, Any]) -> Self:
        """Return the variant of which `to_json` made JSON.

        Raises:
            KeyError: Something is missing.
            ValueError: No variant can be made of it.
        """
        words = tuple(map(str, content["words"]))
        return cls(name, Experiment.from_json(content["experiment"]), words)


@dataclass(frozen=True)
class Job:
    """One run of a comparison: a variant with a seed, or with a block of them.

    Attributes:
        variant: The variant's name.
        seeds: The seed of each of its robots.
        folder: The run folder.
        content: The experiment as JSON, since another process may have to make the user's own
            parts importable first.
        made_in: The current folder when the comparison was made.
    """

    variant: str
    seeds: tuple[int, ...]
    folder: Path
    content: Mapping[str, Any] = field(compare=False)
    made_in: str = field(compare=False)

    @property
    def name(self) -> str:
        """What it is called in its comparison."""
        return f"{self.variant}/{self.folder.name}"

    @property
    def log(self) -> Path:
        """Its log."""
        return self.folder.with_name(f"{self.folder.name}.log")

    @property
    def state(self) -> State:
        """Its state."""
        if (self.folder / SUMMARY).exists():
            return "done"
        if self._failure.exists():
            return "failed"
        return "begun" if (self.folder / CONFIG).exists() else "open"

    @property
    def reason(self) -> str:
        """Why it failed.

        Raises:
            FileNotFoundError: It has not.
        """
        return self._failure.read_text(encoding="utf-8").strip()

    @property
    def n_decisions(self) -> int:
        """How many decisions all its robots together have taken so far, as far as is on disk."""
        try:
            return load_run(self.folder).n_decisions * len(self.seeds)
        except (OSError, ValueError):  # not begun, or just being written
            return 0

    def fail(self, reason: str) -> None:
        """Note why it failed."""
        self.folder.parent.mkdir(parents=True, exist_ok=True)  # it may have died before it began
        self._failure.write_text(" ".join(reason.split()) + "\n", encoding="utf-8")

    def begin(self) -> None:
        """Forget an earlier failure."""
        self._failure.unlink(missing_ok=True)

    def check(self) -> None:
        """Refuse a folder that holds another run.

        Raises:
            ValueError: It does; the message says which.
        """
        if not (self.folder / CONFIG).is_file():
            return
        found = load_run(self.folder).config
        for name, value in self.content.items():
            if found.get(name) != value:
                where, there, here = difference(found.get(name), value, name)
                raise ValueError(
                    f"{self.folder} must hold the run of {self.name}, with {where} {here}, "
                    f"got {there}"
                )

    @property
    def _failure(self) -> Path:
        return self.folder.with_name(f"{self.folder.name}.failed.txt")


@dataclass(frozen=True)
class Comparison:
    """Variants times seeds, in one folder.

    Attributes:
        folder: Where it is.
        variants: What is compared; the first is what others are compared with.
        words: Options of `torch-iac train` for all, if it was described by them.
        n_seeds: How many robots of each variant.
        seed: The seed of the first; each further one has the next.
        block: How many of them, at most, are the population of one run.

    Raises:
        ValueError: There are no variants, two have one name, or a number is out of its range.
    """

    folder: Path
    variants: tuple[Variant, ...]
    words: tuple[str, ...] = ()
    n_seeds: int = 10
    seed: int = 0
    block: int = 1
    made_in: str = field(default_factory=lambda: str(Path.cwd()))
    """The current folder then, where the user's own modules are searched."""

    def __post_init__(self) -> None:
        settle(self)
        if not self.variants:
            raise ValueError("a comparison must have variants (--variant or --variants), got none")
        for name in (names := [variant.name for variant in self.variants]):
            if names.count(name) > 1:
                raise ValueError(f"a variant's name must stand once, got {name} again")
        if not 1 <= self.n_seeds <= MOST_SEEDS:
            raise ValueError(f"seeds must lie in [1, {MOST_SEEDS}], got {self.n_seeds}")
        if self.seed < 0:
            raise ValueError(f"seed must be at least 0, got {self.seed}")
        if not 1 <= self.block <= N_AGENTS_LISTED:
            raise ValueError(
                f"block must lie in [1, {N_AGENTS_LISTED}], the robots that a run's summary lists, "
                f"got {self.block}"
            )

    def jobs(self) -> list[Job]:
        """Return every run, seed by seed, so that variants advance together."""
        end = self.seed + self.n_seeds
        blocks = [
            tuple(range(first, min(first + self.block, end)))
            for first in range(self.seed, end, self.block)
        ]
        return [self._job(variant, seeds) for seeds in blocks for variant in self.variants]

    def _job(self, variant: Variant, seeds: tuple[int, ...]) -> Job:
        first, last = seeds[0], seeds[-1]
        place = f"seed-{first:03d}" if self.block == 1 else f"seeds-{first:03d}-{last:03d}"
        folder = self.folder / variant.name / place
        content = replace(variant.experiment, seeds=seeds).to_json()
        return Job(variant.name, seeds, folder, content, self.made_in)

    def grown(
        self,
        variants: Sequence[Variant] = (),
        words: Sequence[str] = (),
        n_seeds: int | None = None,
        seed: int | None = None,
        block: int | None = None,
    ) -> Self:
        """Return the comparison with more variants, or more or other seeds.

        Args:
            variants: Those to add; what is known already may be among them.
            words: Options for all, the same as before; none for the same.
            n_seeds: How many robots of each variant; as many as before if not given.
            seed: The seed of the first; as before if not given.
            block: The population of one run, the same as before; None for the same.

        Raises:
            ValueError: Something differs of which there are runs already.
        """
        known = {variant.name: variant for variant in self.variants}
        for variant in variants:
            before = known.setdefault(variant.name, variant).to_json()["experiment"]
            now = variant.to_json()["experiment"]
            if before != now:
                where, was, is_now = difference(before, now)
                raise ValueError(
                    f"{where} of {variant.name} must stay {was}, as {self.folder} began, "
                    f"got {is_now}"
                )
        self._check_same("the words for all", self.words, tuple(words) or self.words)
        self._check_same("block", self.block, self.block if block is None else block)
        return replace(
            self,
            variants=tuple(known.values()),
            n_seeds=self.n_seeds if n_seeds is None else n_seeds,
            seed=self.seed if seed is None else seed,
        )

    def _check_same(self, what: str, before: Any, now: Any) -> None:
        if before != now:
            texts = [join(of) if isinstance(of, tuple) else of for of in (before, now)]
            raise ValueError(
                f"{what} must stay `{texts[0]}`, as {self.folder} began, got `{texts[1]}`"
            )

    def save(self) -> None:
        """Write the plan; several processes may do so at once."""
        self.folder.mkdir(parents=True, exist_ok=True)
        content = {
            "variants": {variant.name: variant.to_json() for variant in self.variants},
            "words": list(self.words),
            "seeds": self.n_seeds,
            "seed": self.seed,
            "block": self.block,
            "made_in": self.made_in,
        }
        with NamedTemporaryFile(dir=self.folder, prefix=f".{PLAN}.", delete=False) as file:
            file.write(dump_json(content))
        sync(Path(file.name))
        Path(file.name).replace(self.folder / PLAN)
        sync_names(self.folder)


def load_comparison(folder: Path | str) -> Comparison:
    """Return the comparison that a folder holds.

    Raises:
        FileNotFoundError: It holds none.
        ValueError: Its plan cannot be read.
    """
    folder = Path(folder)
    path = folder / PLAN
    if not path.is_file():
        raise FileNotFoundError(f"{folder} holds no comparison: there is no {PLAN} in it")
    try:
        plan = parse_json(path.read_bytes())
        n_seeds, seed, block = (int(plan[name]) for name in ("seeds", "seed", "block"))
        made_in = str(plan["made_in"])
        for place in (made_in, Path.cwd()):
            make_importable(place)
        variants = tuple(Variant.from_json(name, of) for name, of in plan["variants"].items())
        return Comparison(folder, variants, tuple(plan["words"]), n_seeds, seed, block, made_in)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


def plan_comparison(
    folder: Path,
    variants: Sequence[Variant],
    words: Sequence[str] = (),
    *,
    n_seeds: int | None = None,
    seed: int | None = None,
    block: int | None = None,
) -> Comparison:
    """Return the comparison that a folder holds, grown by what is asked for, or a new one.

    Args:
        folder: Its folder.
        variants: As for `Comparison.grown`, as are all others.
        words: Options for all.
        n_seeds: How many robots of each variant.
        seed: The seed of the first.
        block: The population of one run.

    Raises:
        ValueError: Something is refused, or differs of which there are runs already.
    """
    folder = folder.absolute()  # the current folder of the workers may be another
    numbers = {"n_seeds": n_seeds, "seed": seed, "block": block}
    if (folder / PLAN).exists():
        return load_comparison(folder).grown(variants, words, **numbers)
    given: dict[str, Any] = {name: number for name, number in numbers.items() if number is not None}
    return Comparison(folder, tuple(variants), tuple(words), **given)


def ended_runs(comparison: Comparison) -> dict[str, list[Run]]:
    """Return the runs of each variant that went to their end, by seed."""
    jobs = comparison.jobs()
    return {
        variant.name: load_ended(job for job in jobs if job.variant == variant.name)
        for variant in comparison.variants
    }


def load_ended(jobs: Iterable[Job]) -> list[Run]:
    """Return those runs that went to their end."""
    return [load_run(job.folder) for job in jobs if job.state == "done"]


def part_of(jobs: Sequence[Job], part: str) -> list[Job]:
    """Return every N-th run, from the I-th on, for a part written I/N.

    Raises:
        ValueError: It is not written so, or I is not in [1, N].
    """
    found = re.fullmatch(r"(\d+)/(\d+)", part)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise ValueError(f"only must be written I/N, with I in [1, N], got {part}")
    return list(jobs[int(found[1]) - 1 :: int(found[2])])


def count_states(jobs: Sequence[Job]) -> str:
    """Return in words how many runs are in each state."""
    words = {"done": "done", "failed": "failed", "begun": "half done", "open": "not begun"}
    states = [job.state for job in jobs]
    return ", ".join(f"{states.count(s)} {w}" for s, w in words.items() if s in states)


def difference(one: Any, other: Any, where: str = "") -> tuple[str, Any, Any]:
    """Return where JSON first differs from other JSON, and what stands there in both."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for name in [*one, *other]:
            if one.get(name) != other.get(name):
                place = f"{where}.{name}" if where else name
                return difference(one.get(name), other.get(name), place)
    return where, one, other
