"""Results of a comparison: each robot's measures, and how variants differ in them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np

from torch_iac.analysis.intervals import (
    PART,
    POSITIVE,
    Estimate,
    Range,
    difference,
    holm,
    mean,
    p_value,
    probability_larger,
)
from torch_iac.compare.plan import Comparison
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import MAIN, shadow_error
from torch_iac.runs.summary import SETTLING
from torch_iac.toy_room import BETTER_SHARES, FOCUS_SHARES

Better = Literal["lower", "higher"]
"""Which values of a measure are better."""

MOST_PAIRED = 4
"""With more variants, the report compares each with the first only."""

MANY_SEEDS = 10
"""With fewer, no difference is called clear."""

MOST_CHANCE = 0.05
"""How probable it is at most that chance alone makes any of the clear differences."""

Row = dict[str, Any]
"""The values of a robot, by column."""

_LATE = f"in the last {SETTLING:,} decisions"


@dataclass(frozen=True)
class Measure:
    """A number that each robot has.

    Attributes:
        name: Its column.
        title: What it is, in a few words.
        label: What it is exactly.
        better: Which values are better; None if neither.
        path: Where a summary has it, under each robot.
        within: Where its values can lie.
    """

    name: str
    title: str
    label: str
    better: Better | None
    path: tuple[str, ...]
    within: Range = POSITIVE

    def of(self, agent: Mapping[str, Any]) -> float:
        """Return it for a robot of a summary; NaN if missing."""
        found: Any = agent
        for name in self.path:
            found = (found or {}).get(name)
        return math.nan if found is None else float(found)


@dataclass(frozen=True)
class Difference:
    """How two variants differ in a measure, over the seeds that both have.

    Attributes:
        measure: Which measure.
        one: The name of a variant.
        other: That of another.
        by: How much larger the mean of the one is.
        improvement: Probability that a robot of the one is better than one of the other; None if
            neither direction is better.
        p: How probable so large a difference is where there is none; NaN with less than two seeds.
        p_holm: That, adjusted by Holm for all differences that the report shows; NaN for others.
    """

    measure: Measure
    one: str
    other: str
    by: Estimate
    improvement: Estimate | None
    p: float
    p_holm: float = math.nan

    @property
    def is_clear(self) -> bool:
        """Whether it is hardly made by chance, among all that the report shows."""
        return self.by.n >= MANY_SEEDS and self.p_holm < MOST_CHANCE


def measures_of(runs: Sequence[Run]) -> list[Measure]:
    """Return what can be measured of each robot of some runs."""
    zones = _names(run.zone_names for run in runs)
    shadows = _names(run.shadow_names for run in runs)
    settled = f"after the first {SETTLING:,} decisions"
    return [
        _late_error("error", "error", "errors", MAIN, "mean"),
        *(
            _late_error(f"error/{zone}", f"error in {zone}", "late_zone_errors", zone)
            for zone in zones
        ),
        *(
            _late_error(shadow_error(name), f"error of shadow {name}", "errors", name, "mean")
            for name in shadows
        ),
        *(_network_shares(zones) if any(run.is_hybrid for run in runs) else ()),
        *(
            Measure(
                f"share/{zone}",
                title := f"share of time in {zone}",
                f"{title} {settled}",
                BETTER_SHARES.get(zone),
                ("settled_zone_shares", zone),
                PART,
            )
            for zone in zones
        ),
        *(
            Measure(
                f"focus/{zone}",
                title := f"focus on {zone}",
                f"first decision of the {title}",
                "lower",
                ("focus", zone),
            )
            for zone in FOCUS_SHARES
            if zone in zones
        ),
        Measure("n_regions", "regions", "number of regions", None, ("n_regions",)),
    ]


def _late_error(name: str, title: str, *path: str) -> Measure:
    return Measure(name, title, f"{title} {_LATE}", "lower", path)


def _network_shares(zones: Sequence[str]) -> list[Measure]:
    """Return how often hybrid experts used the network, in all and in each zone."""
    places = {"": ("mean",)} | {zone: ("zones", zone) for zone in zones}
    return [
        Measure(
            f"network_share/{zone}" if zone else "network_share",
            title := f"share of the network in {zone}" if zone else "share of the network",
            f"{title} {_LATE}",
            None,
            ("network_share", *path),
            PART,
        )
        for zone, path in places.items()
    ]


def measure_rows(
    comparison: Comparison, runs: Mapping[str, Sequence[Run]], measures: Sequence[Measure]
) -> list[Row]:
    """Return one row a robot: its variant, its seed, its run and each measure.

    Args:
        comparison: Whose runs they are.
        runs: The ended runs of each variant, by its name.
        measures: What is known of each robot; NaN where it has none.
    """
    return [
        {
            "variant": variant,
            "seed": agent["seed"],
            "run": str(run.folder.relative_to(comparison.folder)),
            "n_decisions": run.summary["n_decisions"],
            "run_seconds": run.summary["seconds"],
            **{measure.name: measure.of(agent) for measure in measures},
        }
        for variant, of in runs.items()
        for run in of
        for agent in run.summary["agents"]
    ]


def differences_of(
    rows: Sequence[Row], measures: Sequence[Measure], variants: Sequence[str]
) -> list[Difference]:
    """Return how each two variants differ in each measure, if they have seeds in common."""
    pairs = list(combinations(variants, 2))
    found = [_difference(rows, measure, *pair) for measure in measures for pair in pairs]
    return _adjusted([of for of in found if of.by.n], shown_pairs(variants))


def shown_pairs(variants: Sequence[str]) -> list[tuple[str, str]]:
    """Return which variants the report compares with which."""
    pairs = list(combinations(variants, 2))
    return pairs if len(variants) <= MOST_PAIRED else pairs[: len(variants) - 1]


def _adjusted(
    differences: Sequence[Difference], shown: Sequence[tuple[str, str]]
) -> list[Difference]:
    """Return the differences with p-values adjusted for those of the pairs that are shown."""
    p_values = [of.p if (of.one, of.other) in shown else math.nan for of in differences]
    adjusted = holm(np.array(p_values, dtype=np.float64)).tolist()
    return [replace(of, p_holm=p) for of, p in zip(differences, adjusted, strict=True)]


def mean_of(rows: Sequence[Row], measure: Measure) -> Estimate:
    """Return the mean of a measure over the robots that have it."""
    values = np.array([row[measure.name] for row in rows], dtype=np.float64)
    return mean(values[np.isfinite(values)], measure.within)


def _difference(rows: Sequence[Row], measure: Measure, one: str, other: str) -> Difference:
    of_one, of_other = (_by_seed(rows, measure, variant) for variant in (one, other))
    seeds = sorted(of_one.keys() & of_other.keys())
    mine, theirs = (np.array([of[seed] for seed in seeds]) for of in (of_one, of_other))
    better = {"higher": (mine, theirs), "lower": (theirs, mine)}
    improvement = probability_larger(*better[measure.better]) if measure.better else None
    by, p = difference(mine, theirs), p_value(mine, theirs)
    return Difference(measure, one, other, by, improvement, p)


def _by_seed(rows: Sequence[Row], measure: Measure, variant: str) -> dict[int, float]:
    """Return the known values of a variant's robots."""
    mine = {row["seed"]: row[measure.name] for row in rows if row["variant"] == variant}
    return {seed: value for seed, value in mine.items() if not math.isnan(value)}


def _names(groups: Iterable[Iterable[str]]) -> list[str]:
    """Return the names in some groups, each once, in order of appearance."""
    return list(dict.fromkeys(name for group in groups for name in group))
