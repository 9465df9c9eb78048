"""Can reinforcement learning be curious? SAC maximises learning progress in the toy room.

    python -m scripts.studies.sac

Robots whose actions SAC chooses (stable-baselines3), with learning progress as the reward, beside
robots that choose as the paper says and robots that act at random; these are the first ones of
`scripts.studies.reproduce_paper`. Prints how they spent their time, what they came to know and how
much progress they met, and draws their time. Runs that are in the folders already are not run
again. Needs the extra `sb3`.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from stable_baselines3 import SAC

import torch_iac as iac
from scripts.studies.claims import each, focus, gaps, in_order, last_error
from scripts.studies.reproduce_paper import SETS, runs_in
from scripts.studies.reproduce_paper import VARIANTS as PAPERS
from scripts.studies.reproduce_paper import Study as PaperStudy
from torch_iac.analysis.generalisation import sets_aside
from torch_iac.analysis.intervals import difference, in_words
from torch_iac.analysis.style import save
from torch_iac.compare.engine import run_variants
from torch_iac.compare.plan import Job
from torch_iac.compare.plots import Curves, draw_shares
from torch_iac.runs.reader import Run
from torch_iac.runs.recorder import Recorder
from torch_iac.toy_room import OUTCOMES, WORLDS

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Learner:
    """What SAC is told that is not its default; the same for all variants but for `gamma`."""

    gamma: float
    """How much the next decision's reward counts; at 0 only the next one does, as for IAC."""
    buffer_size: int = 2000
    """It learns from the last so many decisions: the reward of older ones is out of date."""
    learning_starts: int = 300
    """As many random actions come first; there is no progress before 300 errors."""
    train_freq: int = 4
    """Decisions between two gradient steps."""
    batch_size: int = 128
    """Decisions that a gradient step is made of."""
    learning_rate: float = 1e-3
    """Of actor, critics and entropy coefficient."""
    ent_coef: str = "auto_0.1"
    """The entropy coefficient is found by SAC, from 0.1 on."""
    target_entropy: float = 0.0
    """How much chance it leaves in its actions; -3 is its default here, 2.1 would be all chance."""
    net_arch: tuple[int, ...] = (64, 64)
    """Hidden units of actor and critics."""


SCALE = 100.0
"""What progress is multiplied by, so that rewards are about 1."""

LEARNERS = {"SAC-next-reward-only": Learner(gamma=0.0), "SAC-far-sighted": Learner(gamma=0.9)}
LABELS = {
    "SAC-next-reward-only": "SAC, next reward only",
    "SAC-far-sighted": "SAC, far-sighted",
    "IAC": "IAC",
    "random": "random",
}

ROBOTS = replace(PAPERS["knn"], world="toyroom")
"""Whose experts make the progress; SAC chooses what they do."""

OTHERS = {"IAC": "knn", "random": "knn-random"}
"""What the others are called here, and in `scripts.studies.reproduce_paper`."""

N_OTHERS = 15
"""How many of them there are, with the seeds 0, 1, ..."""


@dataclass(frozen=True)
class Study:
    """How many robots, and for how long."""

    seeds: int = 10
    """How many robots SAC drives in each way, with the seeds 0, 1, ..."""
    steps: int = 10_000
    """How many decisions each takes."""
    out: Path = Path("runs/sac")
    """Where SAC's run folders and the figure go."""
    paper: Path = Path("runs/paper")
    """Where the others' runs are, or go."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print and draw."""
    torch.set_num_threads(1)
    here = replace(ROBOTS, steps=study.steps)
    of_sac = run_variants(
        study.out,
        dict.fromkeys(LEARNERS, here),
        n_seeds=study.seeds,
        processes=study.processes,
        make=run_sac,
    )
    paper = PaperStudy(steps=study.steps, out=study.paper, processes=study.processes)
    others = runs_in("toyroom", {of: PAPERS[of] for of in OTHERS.values()}, N_OTHERS, paper)
    by_name = {"IAC": others[OTHERS["IAC"]], **of_sac, "random": others[OTHERS["random"]]}
    runs = {LABELS[name]: of for name, of in by_name.items()}
    print_table(runs, study.steps // 2)
    print_differences(runs)
    curves = {name: Curves.of(of) for name, of in runs.items()}
    save(draw_shares(curves), study.out / "shares.png")


def run_sac(job: Job) -> None:
    """Make a run of a comparison: SAC maximises the progress of the robot's experts."""
    shutil.rmtree(job.folder, ignore_errors=True)  # SAC cannot go on where it stopped
    maximise(LEARNERS[job.variant], iac.Experiment.from_json(job.content), job.folder)


def maximise(learner: Learner, experiment: iac.Experiment, folder: Path) -> None:
    """Let SAC maximise the learning progress of a robot's experts in a toy room."""
    (seed,) = experiment.seeds
    world = gym.make(WORLDS[experiment.world])
    outcomes = OUTCOMES[experiment.world]
    env = iac.ProgressReward(world, experiment.config, outcomes=outcomes, seed=seed, scale=SCALE)
    numbers = asdict(learner)
    policy = {"net_arch": list(numbers.pop("net_arch"))}
    sac = SAC("MlpPolicy", env, policy_kwargs=policy, seed=seed, device="cpu", **numbers)
    zones = env.metadata["zone_names"]
    with Recorder(folder, env.agent, zones, experiment.to_json()) as recorder:
        sac.learn(experiment.steps, callback=keeper(env, recorder, experiment.tests(folder)))
    env.close()


def keeper(
    env: iac.ProgressReward, recorder: Recorder, test: Callable[[iac.IAC], None]
) -> Callable[[dict[str, Any], Any], bool]:
    """Return what SAC is to call after each decision: it keeps the decision, and goes on."""

    def keep(seen: dict[str, Any], _: Any) -> bool:
        assert env.last is not None
        recorder.record(env.last, np.array([seen["infos"][0]["zone"]]))
        test(env.agent)
        return True

    return keep


def print_table(runs: Mapping[str, Sequence[Run]], late: int) -> None:
    """Print what became of each kind of robots: means, and the range over robots."""
    print(f"| | {' | '.join(f'{name} ({len(zones_of(of))})' for name, of in runs.items())} |")
    print("|---" * (1 + len(runs)) + "|")
    for title, cell in rows(late).items():
        print(f"| {title} | {' | '.join(cell(of) for of in runs.values())} |")


def rows(late: int) -> dict[str, Callable[[Sequence[Run]], str]]:
    """Return what is measured, and how."""

    def share(part: slice, zone: int) -> Callable[[Sequence[Run]], str]:
        return lambda of: spread((zones_of(of)[:, part] == zone).mean(axis=1), ".0%")

    def error(which: str) -> Callable[[Sequence[Run]], str]:
        return lambda of: spread(last_error(of, which, "absolute"), ".4f")

    def gap(which: str) -> Callable[[Sequence[Run]], str]:
        return lambda of: spread(gaps(of, sets[which]), ".3f")

    sets = sets_aside(ROBOTS.world, {})
    parts = {"first 1,000": slice(1000), f"last {late:,}": slice(-late, None)}
    return {
        **{f"{of}: f{z + 1}": share(part, z) for of, part in parts.items() for z in range(3)},
        "focus on f3": lambda of: when(focus(of, "f3")),
        "focus on f2": lambda of: when(focus(of, "f2")),
        "f3 first, then f2": lambda of: f"{in_order(of).sum()} of {len(in_order(of))}",
        "error in f2, contexts met": error("met"),
        "error in f2, anywhere": error("anywhere"),
        "gaps in f2, contexts met": gap("met"),
        "gaps in f2, anywhere": gap("anywhere"),
        "progress a decision, in 1,000ths": lambda of: spread(
            1000 * each(of, lambda run: run.column("progress").mean(axis=0)), ".1f"
        ),
    }


def print_differences(runs: Mapping[str, Sequence[Run]]) -> None:
    """Print how the last errors of SAC's robots differ from those of robots with the same seeds."""
    titles = [f"less that of {name}" for name in OTHERS]
    print(f"\n| error in f2 | {' | '.join(titles)} |\n|---|---|---|")
    for name in map(LABELS.__getitem__, LEARNERS):
        for which, title in SETS.items():
            mine = last_error(runs[name], which, "absolute")
            theirs = (last_error(runs[of], which, "absolute")[: len(mine)] for of in OTHERS)
            cells = [in_words(difference(mine, of)) for of in theirs]
            print(f"| {name}; {title[0].lower()}{title[1:]} | {' | '.join(cells)} |")


def zones_of(runs: Sequence[Run]) -> NDArray[np.int64]:
    """Return the zones of the decisions of each robot, shape `(A, decisions)`."""
    return np.concatenate([run.column("zone").T for run in runs])


def when(steps: Values) -> str:
    """Return the median decision at which robots did something, and how many did."""
    reached = steps[np.isfinite(steps)]
    if not len(reached):
        return "never"
    return f"{np.median(reached):,.0f} ({len(reached)} of {len(steps)})"


def spread(values: Values, unit: str) -> str:
    """Return the mean of what robots did, and the range over them."""
    return f"{values.mean():{unit}} ({values.min():{unit}} to {values.max():{unit}})"


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
