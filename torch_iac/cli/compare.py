"""The command `torch-iac compare`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import split
from typing import Any

from torch_iac.cli.commands import Compare
from torch_iac.cli.exits import StoppedBySignalError, leave
from torch_iac.cli.options import experiment_of
from torch_iac.compare.engine import complete
from torch_iac.compare.executors import Ended, on_processes, on_ray, run_experiment
from torch_iac.compare.plan import (
    PLAN,
    Comparison,
    Job,
    Variant,
    count_states,
    load_comparison,
    part_of,
    plan_comparison,
)
from torch_iac.experiment import Experiment
from torch_iac.internal.files import parse_json
from torch_iac.internal.stop_signals import stopping
from torch_iac.internal.validation import check_count

OWN_WORDS = ("--seed", "--agents", "--out")
"""Options that a comparison itself sets for each of its runs."""


def compare(asked: Compare, words: Sequence[str]) -> None:
    """Run `torch-iac compare`; `words` are options for all runs.

    Raises:
        StoppedBySignalError: It was asked to stop, and the runs have saved themselves.
        ValueError: Something of it is refused; the message says the rule and the value.
    """
    comparison = _comparison(asked, words)
    if not asked.report:
        _carry_out(asked, comparison)
    _answer(asked, comparison)


def _comparison(asked: Compare, words: Sequence[str]) -> Comparison:
    """Return the comparison in the folder, if any, grown by what is asked for."""
    check_count("processes", asked.processes)
    check_words(words, "a comparison")
    described = _in_file(asked.variants) if asked.variants else {}
    for text in asked.variant:
        name, colon, its_words = text.partition(":")
        if not colon:
            raise ValueError(f"a variant must be written NAME: WORDS, got {text}")
        if name.strip() in described:
            raise ValueError(f"a variant's name must stand once, got {name.strip()} again")
        described[name.strip()] = _split(its_words, f"variant {name.strip()}")
    folder, numbers = asked.folder, {"n_seeds": asked.seeds, "seed": asked.seed}
    known = load_comparison(folder).words if (folder / PLAN).exists() else ()
    variants = _variants(described, tuple(words) or known)
    return plan_comparison(folder, variants, words, **numbers, block=asked.block)


def _variants(
    described: Mapping[str, Sequence[str]], for_all: Sequence[str]
) -> tuple[Variant, ...]:
    """Return the variants that words describe.

    Raises:
        ValueError: One is refused; the message names it.
    """
    variants = []
    for name, words in described.items():
        check_words(words, f"variant {name}")
        variant = Variant(name, Experiment(), tuple(words))  # refuses the name
        try:
            experiment = experiment_of([*for_all, *words])
        except ValueError as error:
            raise ValueError(f"variant {name}: {error}") from None
        variants.append(Variant(name, experiment, variant.words))
    return tuple(variants)


def _in_file(path: Path) -> dict[str, Sequence[str]]:
    """Return the words of variants in a JSON file: under each name, as a list or as one text.

    Raises:
        OSError: The file cannot be read.
        ValueError: It holds something else.
    """
    try:
        content = parse_json(path.read_bytes())
        if not isinstance(content, Mapping):
            raise ValueError(f"variants must be names, each with words, got {str(content)[:80]}")
        return {name: _words(name, of) for name, of in content.items()}
    except ValueError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


def _words(name: str, of: Any) -> Sequence[str]:
    if isinstance(of, str):
        return _split(of, f"variant {name}")
    if not isinstance(of, Sequence) or not all(isinstance(word, str) for word in of):
        raise ValueError(f"the words of {name} must be a list of texts, got {str(of)[:80]}")
    return of


def check_words(words: Sequence[str], whose: str) -> None:
    """Refuse options that a comparison itself sets for each of its runs.

    Raises:
        ValueError: One is among them.
    """
    for word in words:
        if word.partition("=")[0] in OWN_WORDS:
            raise ValueError(
                f"{whose} must leave {', '.join(OWN_WORDS)} to torch-iac compare, got {word}"
            )


def _split(text: str, whose: str) -> tuple[str, ...]:
    try:
        return tuple(split(text))
    except ValueError as error:  # such as a quotation that does not end
        raise ValueError(f"the words of {whose} cannot be read ({error}): {text.strip()}") from None


def _carry_out(asked: Compare, comparison: Comparison) -> None:
    """Carry out the runs that are not done."""

    def begin(jobs: Sequence[Job]) -> Ended:
        if asked.ray is None:
            return on_processes(jobs, run_experiment, asked.processes)
        return on_ray(jobs, run_experiment, asked.ray, asked.gpus)

    jobs = _part(comparison.jobs(), asked)
    with stopping() as stop:
        is_over = complete(comparison, jobs, begin, stop, elsewhere=asked.ray is not None)
    if not is_over:
        raise StoppedBySignalError(
            stop.signals[0], f"stopped; go on with: torch-iac compare {asked.folder}"
        )


def _part(jobs: Sequence[Job], asked: Compare) -> Sequence[Job]:
    """Return the runs that a command is about."""
    return part_of(jobs, asked.only) if asked.only else jobs


def _answer(asked: Compare, comparison: Comparison) -> None:
    """Write the report; print its path, and which runs failed."""
    from torch_iac.compare.report import save_report  # with scipy and matplotlib

    mine = _part(comparison.jobs(), asked)
    lines = [f"{len(mine)} run{'s' if len(mine) != 1 else ''}: {count_states(mine)}."]
    if asked.only is None and any(job.state == "done" for job in mine):
        lines.append(f"Read {save_report(comparison)}, or: tensorboard --logdir {asked.folder}")
    print("\n".join(lines))  # noqa: T201 - the command's answer
    failed = [job for job in mine if job.state == "failed"]
    if failed:
        leave(1, "\n".join(f"{job.name} failed: {job.reason}" for job in failed))
