"""The command `torch-iac compare`."""

from collections.abc import Sequence

import gymnasium as gym

from torch_iac.cli.commands import Compare
from torch_iac.cli.exits import StoppedError, stopping
from torch_iac.cli.options import settings_of
from torch_iac.cli.parser_errors import leave
from torch_iac.cli.train import go_on
from torch_iac.compare.executors import carry_out, on_processes, on_ray
from torch_iac.compare.plan import (
    PLAN,
    Comparison,
    Job,
    Variant,
    load_comparison,
    part_of,
    read_variants,
    tally_states,
)
from torch_iac.internal.validation import check_count


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
    with stopping() as stop:
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
    from torch_iac.compare.report import save_report  # with scipy and matplotlib

    mine = _part(comparison.jobs(), asked)
    lines = [f"{len(mine)} run{'s' if len(mine) != 1 else ''}: {tally_states(mine)}."]
    if asked.only is None and any(job.state == "done" for job in mine):
        lines.append(f"Read {save_report(comparison)}, or: tensorboard --logdir {asked.folder}")
    print("\n".join(lines))  # noqa: T201 - the command's answer
    failed = [job for job in mine if job.state == "failed"]
    if failed:
        leave(1, "\n".join(f"{job.name} failed: {job.reason}" for job in failed))
