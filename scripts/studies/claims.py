"""The papers' claims: what each says, how it is measured here, and what would bear it out.

All of this was fixed before the runs that it judges were looked at. A claim is *reproduced* if the
whole 95 % interval of its number is beyond its bar, *partly* if it is beyond a lesser one, and else
*not*.

Shapes: `A` robots, `T` decisions, `P` tests.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from torch_iac.analysis.generalisation import F2, Transitions, plateau, tests_of
from torch_iac.analysis.intervals import PART, Estimate, difference, mean, share
from torch_iac.analysis.region_history import leaf_purity
from torch_iac.runs.reader import Run
from torch_iac.runs.statistics import focus_steps
from torch_iac.runs.summary import SETTLING
from torch_iac.space import Dimension
from torch_iac.toy_room import FOCUS_SHARES

Values = NDArray[np.float64]
Better = Literal["higher", "lower"]
Verdict = Literal["reproduced", "partly", "not"]
Group = Mapping[str, Sequence[Run]]
"""Robots of one kind, by seed: `iac`, and with other drives `random`, `max` and `global`."""

F1 = 0
NS = 250
BOUNDARY, NEAR = 2 / 3, 0.07  # where f3 begins, and what is near it
WHEELS = ("action/left_wheel", "action/right_wheel")
N_CELLS, N_SPAN, N_SHUFFLES = 4, 100, 20  # of each wheel's range; f2 decisions; orders
LAST_TESTS = 5  # whose mean is the last error
SPAN_TESTS = 5  # 500 decisions
SPREAD = 1e-4 / 0.09**2  # 2007's variance, where errors were about 0.09, as a share of their square
LATE = 3000
MATTERS = ("left_wheel", "right_wheel", "toy_distance", "toy_cos", "toy_sin")
"""What decides where the toy will be in f2: how the robot drives, and where the toy is from it."""


@dataclass(frozen=True)
class Claim:
    """Something that a paper says.

    Attributes:
        paper: Which paper.
        says: What it says.
        measured: How that is measured.
        number: The number, of a group of robots.
        needs: Which robots that takes, besides `iac`.
        better: On which side of the bars it bears the claim out.
        bar: Where it is reproduced.
        lesser: Where it is partly reproduced.
        is_part: Whether it is a part of a whole, and is written in percent.
    """

    paper: Literal[2004, 2007]
    says: str
    measured: str
    number: Callable[[Group], Estimate]
    better: Better
    bar: float
    lesser: float
    needs: tuple[str, ...] = ()
    is_part: bool = True

    def verdict(self, found: Estimate) -> Verdict:
        """Return what a number says of the claim."""
        if self.better == "higher":
            return _verdict(found.low > self.bar, found.low > self.lesser)
        return _verdict(found.high < self.bar, found.high < self.lesser)

    @property
    def bars(self) -> str:
        """Return in words where it is reproduced, and where partly."""
        sign = {"higher": "above", "lower": "below"}[self.better]
        ends = [self.bar] + [self.lesser] * (self.lesser != self.bar)
        return f"{sign} {', '.join(f'{end:.0%}' if self.is_part else f'{end:g}' for end in ends)}"


def _verdict(is_above: bool, is_above_lesser: bool) -> Verdict:
    return "reproduced" if is_above else "partly" if is_above_lesser else "not"


def ratio(one: Values, other: Values) -> Estimate:
    """Return how many times the other's the one's values are: the geometric mean, paired."""
    found = difference(np.log(one), np.log(other))
    value, low, high = np.exp([found.value, found.low, found.high]).tolist()
    return Estimate(value, low, high, found.n)


def each(runs: Sequence[Run], measure: Callable[[Run], Sequence[float] | NDArray[Any]]) -> Values:
    """Return a measure of each robot of some runs, shape `(A,)`."""
    return np.concatenate([np.asarray(measure(run), np.float64) for run in runs])


def cut_steps(runs: Sequence[Run], number: int) -> Values:
    """Return at which decision each robot split for the first (0), second (1) time; NaN if not."""
    return each(runs, lambda run: _split(run, number)[0])


def cuts_on_sound(runs: Sequence[Run], number: int) -> Values:
    """Return where each robot's first (0) or second (1) cut is; NaN if not on the sound."""
    return each(runs, lambda run: _split(run, number)[1])


def _split(run: Run, number: int) -> Values:
    """Return when each robot split for that time and where on the sound, shape `(2, A)`."""
    splits = run.regions.filter(pc.field("split_step") >= 0)
    splits = splits.sort_by([("agent", "ascending"), ("split_step", "ascending")])
    agents = splits["agent"].to_numpy()
    nth = np.arange(len(agents)) - np.searchsorted(agents, agents) == number  # of its agent
    on_sound = splits["cut_dimension"].to_numpy() == "sound"
    found = np.full((2, run.n_agents), np.nan)
    found[0, agents[nth]] = splits["split_step"].to_numpy()[nth]
    found[1, agents[nth]] = np.where(on_sound, splits["cut_value"], np.nan)[nth]
    return found


def focus(runs: Sequence[Run], zone: str) -> Values:
    """Return when each robot first focused on a zone; NaN if it never did."""
    return each(runs, lambda run: np.array(focus_steps(run, zone, FOCUS_SHARES[zone]), float))


def in_order(runs: Sequence[Run]) -> NDArray[np.bool_]:
    """Return which robots focused on f3 and, later, on f2."""
    return focus(runs, "f3") < focus(runs, "f2")


def time_in(runs: Sequence[Run], zone: int, start: int) -> Values:
    """Return the share of its decisions, from one on, that each robot spent in a zone."""
    return each(runs, lambda run: (run.column("zone")[start:] == zone).mean(axis=0))


def switching(runs: Sequence[Run]) -> Values:
    """Return how many times as often as by chance each robot goes between f1 and elsewhere.

    By chance it would go as often as if its decisions came in a random order.
    """

    def of(run: Run) -> Values:
        there = run.column("zone")[SETTLING:] == F1
        chance = 2 * there.mean(axis=0) * (1 - there.mean(axis=0))
        return np.asarray((there[1:] != there[:-1]).mean(axis=0) / chance)

    return each(runs, of)


def organisation(runs: Sequence[Run]) -> Values:
    """Return which share of the wheels' entropy in f2 the time explains, beyond shuffled time.

    The wheel speeds of each robot's decisions in f2, random ones left out, fall into 4 by 4 cells;
    time is cut into spans of 100 such decisions. The mutual information of span and cell, less its
    mean when the same decisions are shuffled over the spans, over the entropy of the cells.
    """
    return each(runs, lambda run: [_organisation(run, agent) for agent in range(run.n_agents)])


def _organisation(run: Run, agent: int) -> float:
    steps = run.table([*WHEELS, "zone", "random_action"], agent)
    chosen = (steps["zone"].to_numpy() == F2) & ~steps["random_action"].to_numpy()
    left, right = (
        np.clip((steps[wheel].to_numpy()[chosen] + 1) / 2 * N_CELLS, 0, N_CELLS - 1).astype(int)
        for wheel in WHEELS
    )
    n_spans = len(left) // N_SPAN
    if n_spans < 2:
        return np.nan
    cells = (left * N_CELLS + right)[: n_spans * N_SPAN]
    draw = np.random.default_rng(run.seeds[agent])
    shuffled = [_information(draw.permutation(cells), n_spans) for _ in range(N_SHUFFLES)]
    whole = _entropy(np.bincount(cells, minlength=N_CELLS**2))
    return float((_information(cells, n_spans) - np.mean(shuffled)) / whole)


def _information(cells: NDArray[np.int64], n_spans: int) -> float:
    """Return the mutual information of cell and span (bits)."""
    spans = cells.reshape(n_spans, -1)
    counts = np.stack([np.bincount(span, minlength=N_CELLS**2) for span in spans])
    within = np.mean([_entropy(of) for of in counts])
    return float(_entropy(counts.sum(axis=0)) - within)


def _entropy(counts: NDArray[np.int64]) -> float:
    shares = counts[counts > 0] / counts.sum()
    return float(-(shares * np.log2(shares)).sum())


def last_error(runs: Sequence[Run], which: str, error: str = "squared") -> Values:
    """Return each robot's error in its last tests, shape `(A,)`."""
    return np.asarray(tests_of(runs, which, error)[1][-LAST_TESTS:].mean(axis=0))


def plateaus(runs: Sequence[Run]) -> Values:
    """Return when each robot's squared error on the contexts it may meet ceased to change.

    The first test with which a span of 500 decisions begins whose errors vary as little as in
    2007, relative to the last error; the end for robots that never came so far.
    """
    steps, errors = tests_of(runs, "met", "squared")
    relative = errors / errors[-LAST_TESTS:].mean(axis=0)
    first = plateau(relative, SPAN_TESTS, SPREAD)
    at = np.where(np.isnan(first), len(steps) - 1, first).astype(int)
    return np.asarray(steps[at], np.float64)


def catching_up(runs: Sequence[Run], others: Sequence[Run], which: str) -> Values:
    """Return when each robot was first as good as its twin in the end; NaN if it never was.

    That is the first test with an absolute error of at most the mean last one of the others.
    """
    steps, errors = tests_of(runs, which, "absolute")
    reached = errors <= last_error(others, which, "absolute").mean()
    return np.where(reached.any(axis=0), steps[reached.argmax(axis=0)], np.nan)


def gaps(runs: Sequence[Run], asked: Transitions) -> Values:
    """Return how far transitions set aside in f2 are from what each robot did there, shape `(A,)`.

    The mean distance to the nearest decision in f2 of the robot's whole run, in the dimensions of
    `MATTERS`, each scaled to [0, 1]: how well the robot has covered f2.
    """
    return each(runs, lambda run: nearest(run, asked)[0].mean(axis=1))


def nearest(run: Run, asked: Transitions) -> tuple[Values, Values]:
    """Return the nearest decision in f2 of each robot to each of some transitions, as `gaps` does.

    Returns:
        How far it is, and the absolute error if its outcome were the prediction, scaled; each of
        shape `(A, N)`.
    """
    situation, outcome = run.space.situation, run.space.outcomes
    points = _scaled(np.concatenate([asked.actions, asked.sensors], axis=1), situation)
    met = _scaled(run.columns(run.situation_columns), situation)
    truth = _scaled(asked.outcomes, outcome)
    outcomes = _scaled(run.columns(f"outcome/{d.name}" for d in outcome), outcome)
    columns = [i for i, d in enumerate(situation) if d.name in MATTERS]
    in_f2 = run.column("zone") == F2
    distances, errors = [], []
    for agent, mine in enumerate(in_f2.T):
        found = cKDTree(met[mine, agent][:, columns]).query(points[:, columns])
        distances.append(found[0])
        errors.append(np.abs(outcomes[mine, agent][found[1]] - truth).mean(axis=1))
    return np.array(distances), np.array(errors)


def _scaled(values: NDArray[Any], dimensions: Sequence[Dimension]) -> Values:
    low, high = np.array([(d.low, d.high) for d in dimensions]).T
    return np.asarray((values - low) / (high - low))


def _purity(group: Group) -> Estimate:
    return mean(each(group["iac"], leaf_purity), PART)


def _against(other: str, which: str) -> Callable[[Group], Estimate]:
    return lambda group: ratio(last_error(group["iac"], which), last_error(group[other], which))


def _globally(group: Group) -> Estimate:
    return ratio(last_error(group["global"], "met"), last_error(group["iac"], "met"))


MET = "on contexts met under random actions"
ANYWHERE = "on poses drawn over the room"

CLAIMS = [
    Claim(
        2004,
        "An expert splits when it has more than NS = 250 examples",
        "robots whose first split comes with the 251st decision",
        lambda group: share(cut_steps(group["iac"], 0) == NS),
        "higher",
        0.85,
        0.5,
    ),
    Claim(
        2004,
        "The first split is between sounds",
        "robots whose first cut is on the sound",
        lambda group: share(np.isfinite(cuts_on_sound(group["iac"], 0))),
        "higher",
        0.85,
        0.5,
    ),
    Claim(
        2004,
        "It parts f3 from f1 and f2",
        f"robots whose first cut is on the sound, within {NEAR} of where f3 begins",
        lambda group: share(np.abs(cuts_on_sound(group["iac"], 0) - BOUNDARY) <= NEAR),
        "higher",
        0.85,
        0.5,
    ),
    Claim(
        2004,
        "Groups of experts are coherent: each is of one zone",
        "share of decisions that lie in a leaf mostly of their own zone",
        _purity,
        "higher",
        0.9,
        0.75,
    ),
    Claim(
        2004,
        "The robot focuses on f3 first, then on f2",
        "robots with a window of 250 decisions over 60 % in f3, and a later one over 50 % in f2",
        lambda group: share(in_order(group["iac"])),
        "higher",
        0.85,
        0.5,
    ),
    Claim(
        2004,
        "It minimises the time in f1",
        "share of f1 after 1,000 decisions (random actions alone make 3.3 %)",
        lambda group: mean(time_in(group["iac"], F1, SETTLING), PART),
        "lower",
        0.05,
        0.1,
    ),
    Claim(
        2004,
        "Its exploration of the wheel speeds in f2 is organised",
        "share of the wheels' entropy in f2 that time explains, beyond shuffled time",
        lambda group: mean(organisation(group["iac"])),
        "higher",
        0.05,
        0.01,
    ),
    Claim(
        2004,
        "With one global history of errors the robot does not develop",
        "robots driven so that focus on f3, then on f2",
        lambda group: share(in_order(group["global"])),
        "lower",
        0.15,
        0.5,
        ("global",),
    ),
    Claim(
        2004,
        "Instead it alternates between the predictable and the unpredictable",
        "how many times as often as by chance such robots go between f1 and the rest",
        lambda group: mean(switching(group["global"])),
        "higher",
        1.2,
        1.0,
        ("global",),
        is_part=False,
    ),
    Claim(
        2004,
        "and learns inefficiently",
        f"its squared error in f2 {MET}, over that of IAC, after the last decisions",
        _globally,
        "higher",
        1.1,
        1.0,
        ("global",),
        is_part=False,
    ),
    Claim(
        2007,
        "The second split is on the sound too",
        "robots whose second cut is on the sound",
        lambda group: share(np.isfinite(cuts_on_sound(group["iac"], 1))),
        "higher",
        0.85,
        0.5,
    ),
    Claim(
        2007,
        "After 3,000 decisions, 85 % of the time is in f2",
        "share of f2 after 3,000 decisions",
        lambda group: mean(time_in(group["iac"], F2, LATE), PART),
        "higher",
        0.8,
        0.5,
    ),
    *(
        Claim(
            2007,
            f"In f2 IAC generalises better than {other.upper()}",
            f"its squared error {where}, over that of {other.upper()}, after the last decisions",
            _against(other, which),
            "lower",
            1.0,
            1.0,
            (other,),
            is_part=False,
        )
        for other in ("random", "max")
        for which, where in (("met", MET), ("anywhere", ANYWHERE))
    ),
    Claim(
        2007,
        "and is on its plateau 2.6 times as soon as RANDOM",
        f"RANDOM's decisions to the plateau of the error {MET}, over IAC's",
        lambda group: ratio(plateaus(group["random"]), plateaus(group["iac"])),
        "higher",
        2.0,
        1.0,
        ("random",),
        is_part=False,
    ),
]
