"""Can reinforcement learning be curious? SAC maximises learning progress in the toy room.

    python -m scripts.sac

Robots whose actions SAC chooses (stable-baselines3), with learning progress as the reward, beside
robots that choose as the paper says and robots that act at random, paired by seed. Prints how they
spent their time, what they came to know and how much progress they met, and draws their time.
Runs that are in the folder already are not run again. Needs the extra `sb3`.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from stable_baselines3 import SAC
from tqdm import tqdm

import torch_iac as iac
from scripts.study import Diary, Life, live, tests_of
from torch_iac.charts import Curves, draw_shares, save
from torch_iac.measures import FOCUS_SHARES
from torch_iac.runs import Run, focus_steps, load_run

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
    target_entropy: float = -3.0
    """How much chance SAC leaves in its actions; -3 is its default here, 2.1 all of it."""
    net_arch: tuple[int, ...] = (64, 64)
    """Hidden units of actor and critics."""


SCALE = 100.0
"""What progress is multiplied by, so that rewards are about 1."""

VARIANTS: dict[str, iac.IACConfig | Learner] = {
    "IAC": iac.IACConfig(),
    "SAC, next reward only": Learner(gamma=0.0),
    "SAC, far-sighted": Learner(gamma=0.9),
    "random": iac.IACConfig(drive=iac.Random()),
}


@dataclass(frozen=True)
class Study:
    """How many robots, and for how long."""

    seeds: int = 5
    """How many robots of each kind, with seeds in succession."""
    first_seed: int = 0
    """The first of the seeds."""
    steps: int = 10_000
    """How many decisions each takes."""
    test_every: int = 1000
    """How many decisions lie between two generalisation tests."""
    only: tuple[str, ...] = ()
    """Only these rows of the table; all by default."""
    out: Path = Path("runs/sac")
    """Where the run folders and the figure go."""


def main(study: Study) -> None:
    """Run what is not there yet, one robot after the other, then print and draw."""
    torch.set_num_threads(1)
    names = study.only or tuple(VARIANTS)
    seeds = range(study.first_seed, study.first_seed + study.seeds)
    pairs = [(name, seed) for seed in seeds for name in names]
    for name, seed in tqdm(pairs, unit="run", disable=None):
        develop(VARIANTS[name], life_of(study, name, seed))
    runs = {name: [load_run(life_of(study, name, seed).folder) for seed in seeds] for name in names}
    print_table(runs, study.steps // 2)
    curves = {name: Curves.of(of) for name, of in runs.items()}
    save(draw_shares(curves), study.out / "shares.png")


def life_of(study: Study, name: str, seed: int) -> Life:
    """Return the run of one robot."""
    folder = study.out / name.replace(",", "").replace(" ", "-") / f"seed-{seed:03d}"
    kind = VARIANTS[name]
    config = kind if isinstance(kind, iac.IACConfig) else iac.IACConfig()
    return Life(folder, config, (seed,), study.steps, test_every=study.test_every)


def develop(kind: iac.IACConfig | Learner, life: Life) -> None:
    """Let a robot develop, unless it did already."""
    if isinstance(kind, iac.IACConfig):
        live(life)
    elif not (life.folder / "summary.json").exists():
        maximise(kind, life)


def maximise(kind: Learner, life: Life) -> None:
    """Let SAC maximise the learning progress of the experts of a robot."""
    (seed,) = life.seeds
    world = gym.make(life.world)
    env = iac.ProgressReward(world, life.config, outcomes=["toy_distance"], seed=seed, scale=SCALE)
    numbers = asdict(kind)
    policy = {"net_arch": list(numbers.pop("net_arch"))}
    sac = SAC("MlpPolicy", env, policy_kwargs=policy, seed=seed, device="cpu", **numbers)
    with ExitStack() as stack:
        diary = Diary(life, env.agent, env, stack)
        sac.learn(life.n_decisions, callback=keeper(env, diary))
        diary.close()
    env.close()


def keeper(env: iac.ProgressReward, diary: Diary) -> Callable[[dict[str, Any], Any], bool]:
    """Return what SAC is to call after each decision: it keeps the decision, and goes on."""

    def keep(seen: dict[str, Any], _: Any) -> bool:
        assert env.last is not None
        diary.keep(env.agent, env.last, np.array([seen["infos"][0]["zone"]]))
        return True

    return keep


def print_table(runs: Mapping[str, Sequence[Run]], late: int) -> None:
    """Print what became of each kind of robots: means, and the range over robots."""
    print(
        f"| | first 1,000: f1, f2, f3 | last {late:,}: f1, f2, f3 | focus on f3 | focus on f2 "
        "| error in f2, contexts met | error in f2, anywhere | progress a decision, in 1,000ths "
        f"|\n{'|---' * 8}|"
    )
    for name, of in runs.items():
        cells = [
            shares(of, slice(1000)),
            shares(of, slice(-late, None)),
            *(focus(of, zone) for zone in ("f3", "f2")),
            *(
                spread(tests_of(of, which, "absolute")[1][-1], ".4f")
                for which in ("met", "anywhere")
            ),
            spread(1000 * np.array([run.column("progress").mean() for run in of]), ".1f"),
        ]
        print(f"| {name} | {' | '.join(cells)} |")


def shares(runs: Sequence[Run], part: slice) -> str:
    """Return the mean share of each zone in a part of the decisions, and its range."""
    zones = [run.column("zone")[part, 0] for run in runs]
    found = np.array([np.bincount(of, minlength=3) / len(of) for of in zones])
    return ", ".join(spread(of_zone, ".0%") for of_zone in found.T)


def focus(runs: Sequence[Run], zone: str) -> str:
    """Return the median decision at which robots focused on a zone, and how many did."""
    steps = np.array([focus_steps(run, zone, FOCUS_SHARES[zone])[0] for run in runs], float)
    reached = steps[np.isfinite(steps)]
    if not len(reached):
        return "never"
    return f"{np.median(reached):,.0f} ({len(reached)} of {len(steps)})"


def spread(values: Values, unit: str) -> str:
    """Return the mean of what robots did, and the range over them."""
    return f"{values.mean():{unit}} ({values.min():{unit}} to {values.max():{unit}})"


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
