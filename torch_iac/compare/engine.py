"""Makes the runs of a comparison, for the command and for scripts and notebooks.

```python
runs = run_variants("runs/drives", {"progress": Experiment(), "random": random}, n_seeds=10)
```
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import gymnasium as gym

from torch_iac.compare.executors import Ended, RunJob, carry_out, on_processes, run_experiment
from torch_iac.compare.plan import (
    Comparison,
    Job,
    Variant,
    count_states,
    load_ended,
    plan_comparison,
)
from torch_iac.experiment import Experiment
from torch_iac.internal.cores import n_cores
from torch_iac.internal.stop_signals import stopping
from torch_iac.internal.validation import check_count
from torch_iac.runs.reader import Run


def run_variants(
    folder: Path | str,
    experiments: Mapping[str, Experiment],
    *,
    n_seeds: int,
    seed: int = 0,
    block: int = 1,
    processes: int | None = None,
    make: RunJob = run_experiment,
) -> dict[str, list[Run]]:
    """Run experiments with many seeds each, as far as that is not done yet, and return the runs.

    The folder is a comparison, which `torch-iac compare` goes on with and reports on. Runs that
    were stopped or killed go on from their checkpoints. A script must call this under
    `if __name__ == "__main__":`, since the processes that it starts import the script.

    Args:
        folder: The comparison's folder.
        experiments: What is run, by name; their seeds are those below.
        n_seeds: How many robots of each.
        seed: The seed of the first; each further one has the next.
        block: How many of them, at most, are the population of one run.
        processes: How many runs go on at once; by default one for each core that this process may
            use.
        make: Makes a run where the experiment alone does not; it must be picklable.

    Returns:
        The runs of each experiment, by seed.

    Raises:
        KeyboardInterrupt: It was asked to stop, and the runs have saved themselves.
        RuntimeError: A run failed; the others have ended.
        ValueError: Something is refused, or the folder holds runs of other experiments.
    """
    processes = n_cores() if processes is None else processes
    check_count("processes", processes)
    variants = [Variant(name, experiment) for name, experiment in experiments.items()]
    comparison = plan_comparison(Path(folder), variants, n_seeds=n_seeds, seed=seed, block=block)
    jobs = [job for job in comparison.jobs() if job.variant in experiments]
    with stopping() as stop:
        is_over = complete(
            comparison, jobs, partial(on_processes, live=make, n_processes=processes), stop
        )
    if not is_over:
        raise KeyboardInterrupt(f"stopped, {count_states(jobs)}; the same again goes on")
    failed = [f"{job.name} failed: {job.reason}" for job in jobs if job.state == "failed"]
    if failed:
        raise RuntimeError("; ".join(failed))
    return {name: load_ended(job for job in jobs if job.variant == name) for name in experiments}


def complete(
    comparison: Comparison,
    jobs: Sequence[Job],
    begin: Callable[[Sequence[Job]], Ended],
    stop: Callable[[], bool],
    elsewhere: bool = False,
) -> bool:
    """Make those runs of a comparison that are not done, after checking all of them.

    Args:
        comparison: Its plan is saved before the first run begins.
        jobs: The runs.
        begin: Starts an executor with some runs.
        stop: Asked now and then whether to stop.
        elsewhere: Whether they will be on other machines, with devices of their own.

    Returns:
        Whether all runs have ended, well or not.

    Raises:
        ValueError: One cannot be made; the message names its variant.
    """
    sizes = _sizes(jobs, elsewhere)
    open_jobs = [job for job in jobs if job.state != "done"]
    ended = begin(open_jobs)
    comparison.save()
    return carry_out({job: sizes[job] for job in open_jobs}, ended, stop)


def _sizes(jobs: Sequence[Job], elsewhere: bool) -> dict[Job, int]:
    """Return the number of decisions of all robots of each run, after checking the runs.

    Raises:
        ValueError: One cannot; the message names its variant.
    """
    steps = {}
    for job in {job.variant: job for job in jobs}.values():
        try:
            experiment = Experiment.from_json(job.content)
            experiment.check(elsewhere=elsewhere)
        except (ValueError, gym.error.Error) as error:
            raise ValueError(f"variant {job.variant}: {error}") from None
        steps[job.variant] = experiment.steps
    for job in jobs:
        job.check()
    return {job: steps[job.variant] * len(job.seeds) for job in jobs}
