"""Executors of the runs of a comparison: processes of this machine, or a Ray cluster."""

import logging
import os
import signal
import socket
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, redirect_stderr, redirect_stdout
from datetime import datetime
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import IO, Any

import torch

from torch_iac.compare.plan import Job
from torch_iac.experiment import Experiment, StoppedError
from torch_iac.internal.bars import tqdm
from torch_iac.internal.files import lock
from torch_iac.internal.parts import make_importable
from torch_iac.internal.stop_signals import stopping

TICK = 1.0
"""Seconds between two updates of the progress."""

SECONDS_BETWEEN_LINES = 30.0
"""Seconds between two lines in the log, where there is no terminal for a progress bar."""

SECONDS_TO_SAVE = 60.0
"""How long a run that is asked to stop may take to save itself."""

RETRIES = 3
"""How often Ray retries a run whose process or machine was lost."""

SECONDS_TO_ANSWER = 10.0
"""Timeout (s) for a Ray cluster to answer."""

RunJob = Callable[[Job], None]
"""Begins a run, or goes on with it; raises `KeyboardInterrupt` once it was asked to stop and has
saved itself."""

Ended = Generator[list[Job], None, None]
"""Yields, at least every `TICK`, the runs that have just ended, well or not."""

log = logging.getLogger(__name__)


def run_experiment(job: Job) -> None:
    """Begin a run of a comparison, or go on with it if it has begun.

    Raises:
        KeyboardInterrupt: It was asked to stop, and has saved itself.
    """
    make_importable(job.made_in)
    experiment = Experiment.from_json(job.content)
    try:
        with stopping() as stop:
            experiment.run_or_resume(job.folder, stop=stop)
    except StoppedError as stopped:
        raise KeyboardInterrupt(str(stopped)) from None


def carry_out(sizes: Mapping[Job, int], jobs_ended: Ended, stop: Callable[[], bool]) -> bool:
    """Make runs with an executor, and show progress and the remaining time.

    Args:
        sizes: How many decisions the robots of each run take together.
        jobs_ended: `on_processes` or `on_ray` of these runs.
        stop: Asked every `TICK` whether to stop.

    Returns:
        Whether all runs have ended, well or not.
    """
    with closing(_Progress(sizes)) as progress, closing(jobs_ended):
        for ended in jobs_ended:
            progress.tell(ended)
            if stop():
                return False
    return True


def on_processes(jobs: Sequence[Job], live: RunJob, n_processes: int) -> Ended:
    """Make runs in processes of this machine; one that dies loses only its own run.

    Args:
        jobs: The runs.
        live: What makes a run; it must be picklable.
        n_processes: How many go on at once.
    """
    waiting = deque(jobs)
    workers = [_Worker(live) for _ in range(min(n_processes, len(jobs)))]
    try:
        while waiting or any(worker.job for worker in workers):
            workers = [_Worker(live) if worker.is_dead else worker for worker in workers]
            for worker in workers:
                if waiting and not worker.job:
                    worker.give(waiting.popleft())
            busy = {worker.connection: worker for worker in workers if worker.job}
            ready = wait(list(busy), TICK)
            yield [worker.take() for connection, worker in busy.items() if connection in ready]
    finally:
        for worker in workers:
            worker.dismiss()
        for worker in workers:
            worker.process.join(SECONDS_TO_SAVE)
            worker.process.kill()


def on_ray(jobs: Sequence[Job], live: RunJob, address: str, gpus: float = 0.0) -> Ended:
    """Make runs on a Ray cluster, whose machines see the same folders; lost ones are retried.

    Args:
        jobs: The runs, one task each.
        live: What makes a run.
        address: Where the cluster is, such as `auto` or `10.0.0.1:6379`.
        gpus: Fraction of a GPU that each run gets.

    Raises:
        ValueError: Ray is not installed, or the cluster cannot be reached.
    """
    return _tasks(_connect(address), jobs, live, gpus)


def _tasks(ray: Any, jobs: Sequence[Job], live: RunJob, gpus: float) -> Ended:
    """Submit the runs to Ray, and disconnect in the end."""
    task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=RETRIES)(_ray_task)
    running = {task.remote(job, live): job for job in jobs}
    try:
        while running:
            ready, _ = ray.wait(list(running), num_returns=len(running), timeout=TICK)
            for reference in ready:
                try:
                    ray.get(reference)
                except ray.exceptions.RayError as error:
                    running[reference].fail(f"Ray has lost it: {error}")
            yield [running.pop(reference) for reference in ready]
    finally:
        ray.shutdown()


def run_job(job: Job, live: RunJob) -> None:
    """Make one run, unless it is done; its output and any error go to its log."""
    if job.state == "done":
        return
    torch.set_num_threads(1)
    job.log.parent.mkdir(parents=True, exist_ok=True)
    with job.log.open("a", encoding="utf-8", buffering=1) as file:
        who = f"{socket.gethostname()}, process {os.getpid()}"
        print(f"{datetime.now():%Y-%m-%d %H:%M:%S}, {who}: {job.name}", file=file)
        try:
            with lock_file(file), _speaking_to(file):
                job.begin()
                live(job)
        except BlockingIOError as error:
            print(error, file=file)
        except Exception as error:  # whatever it is, the other runs go on
            traceback.print_exc(file=file)
            job.fail(str(error) or type(error).__name__)


class _Worker:
    """A process that makes one run after the other.

    Attributes:
        process: The process.
        connection: Ready when a run has ended, or the process.
        job: The present run, if there is one.
    """

    def __init__(self, live: RunJob) -> None:
        context = get_context("spawn")  # a fork would copy locks held by threads, without them
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, live), daemon=True)
        with _sigint_ignored():
            self.process.start()
        theirs.close()
        self.job: Job | None = None

    def give(self, job: Job) -> None:
        """Give it a run to make."""
        self.job = job
        self.connection.send(job)

    def take(self) -> Job:
        """Return the run that has ended."""
        job, self.job = self.job, None
        assert job  # noqa: S101 - tells the type checker
        try:
            self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            if self.process.exitcode and job.state != "done":  # 0: it was asked to stop
                job.fail(describe_exit(self.process.exitcode))
        return job

    def dismiss(self) -> None:
        """Let it end, once its present run, if any, has saved itself."""
        self.connection.close()
        if self.job:
            self.process.terminate()

    @property
    def is_dead(self) -> bool:
        """Whether the process has ended."""
        return self.process.exitcode is not None


def _work(connection: Connection, live: RunJob) -> None:
    """Make runs as they come, until end of input or a stop signal."""
    try:
        while True:
            run_job(connection.recv(), live)
            connection.send(None)
    except (EOFError, ConnectionError, KeyboardInterrupt):
        sys.exit(0)


def _ray_task(job: Job, live: RunJob) -> None:
    """Make a run as a task of Ray; one that was asked to stop exits so that Ray retries it."""
    try:
        run_job(job, live)
    except KeyboardInterrupt:
        os._exit(128 + signal.SIGTERM)


def _connect(address: str) -> Any:
    """Return Ray, connected to a cluster."""
    try:
        import ray
    except ImportError:
        raise ValueError("--ray needs Ray: pip install 'torch_iac[ray]'") from None
    try:
        _check_reachable(address)
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ValueError(
            f"ray must be the address of a cluster that lets this machine in, got {address} "
            f"({first}); one that was begun with `ray start --head` may ask for its token "
            "(RAY_AUTH_TOKEN)"
        ) from None
    return ray


def _check_reachable(address: str) -> None:
    """Refuse an address where nothing listens: Ray itself would try for minutes.

    Raises:
        OSError: Nothing does.
    """
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon and port.isdigit():
        socket.create_connection((host, int(port)), SECONDS_TO_ANSWER).close()


@contextmanager
def _sigint_ignored() -> Iterator[None]:
    """Ignore SIGINT in processes started here; they are stopped by SIGTERM."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _speaking_to(file: IO[str]) -> Iterator[None]:
    """Send what is printed and logged to a file."""
    handler, root = logging.StreamHandler(file), logging.getLogger()
    level = root.level
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    try:
        with redirect_stdout(file), redirect_stderr(file):
            yield
    finally:
        root.removeHandler(handler)
        root.setLevel(level)


class _Progress:
    """Shows the progress: a bar on a terminal, else a line in the log now and then."""

    def __init__(self, sizes: Mapping[Job, int]) -> None:
        self._sizes, self._running = sizes, list(sizes)
        self._n_failed = self._n_ended = 0
        self._started = self._spoken = time.monotonic()
        self._before = self._n_decisions()
        self._bar = tqdm(
            total=sum(sizes.values()),
            initial=self._before,
            unit="decision",
            unit_scale=True,
            smoothing=0,  # parts are written seldom, so only the rate since the beginning is known
            disable=None,
        )

    def tell(self, ended: Sequence[Job]) -> None:
        """Update the progress, now that some runs have ended."""
        self._running = [job for job in self._running if job not in ended]
        self._n_ended += sum(self._sizes[job] for job in ended)
        self._n_failed += sum(job.state == "failed" for job in ended)
        words = f"{len(self._sizes) - len(self._running)} of {len(self._sizes)} runs"
        words += f", {self._n_failed} failed" if self._n_failed else ""
        n_decisions, now = self._n_decisions(), time.monotonic()
        self._bar.n = n_decisions
        self._bar.set_postfix_str(words)
        if self._bar.disable and now - self._spoken >= SECONDS_BETWEEN_LINES:
            self._spoken = now
            log.info("%s%s", words, self._left(n_decisions, now - self._started))

    def close(self) -> None:
        """Close the bar."""
        self._bar.close()

    def _n_decisions(self) -> int:
        """Return how many decisions were taken; those that a failure left out count as taken."""
        return self._n_ended + sum(job.n_decisions for job in self._running)

    def _left(self, n_decisions: int, seconds: float) -> str:
        """Return in words how long it will still take, once that can be known."""
        taken, left = n_decisions - self._before, sum(self._sizes.values()) - n_decisions
        return f", about {tqdm.format_interval(seconds * left / taken)} left" if taken else ""


def describe_exit(code: int | None) -> str:
    """Return in words how a process ended."""
    if code is not None and code < 0:
        return f"its process was killed by {signal.Signals(-code).name}"
    return f"its process ended with exit code {code}"


@contextmanager
def lock_file(log: IO[str]) -> Iterator[None]:
    """Keep other processes from the same run, by a lock on its log that no crash leaves behind.

    Raises:
        BlockingIOError: Another process is making it.
    """
    if not lock(log):
        raise BlockingIOError(f"another process is at the run of {log.name}")
    yield
