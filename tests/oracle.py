"""The paper in plain Python: one robot, lists and loops, no torch. It decides what is right.

A transcription of Oudeyer and Kaplan (2004), section 2.1, with the choices that DESIGN makes where
the paper is silent. Slow on purpose: nothing is remembered that the text does not speak of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction

Vector = Sequence[float]
GRID = 2**23  # outcomes are whole multiples of 1 / GRID, so that C2 can be decided exactly


@dataclass
class Region:
    """An expert: its examples, the errors it has made, and, once split, its cut and children."""

    number: int
    examples: list[tuple[Vector, Vector]] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    dimension: int = -1
    value: float = 0.0
    children: tuple[Region, Region] | None = None


@dataclass
class Robot:
    """One robot of the paper."""

    max_examples: int = 250
    balance: float = 0.15
    window: int = 150
    delay: int = 150
    k: int = 1
    squared: bool = False
    inherit_history: bool = True
    root: Region = field(default_factory=lambda: Region(0))
    n_regions: int = 1

    def region_of(self, situation: Vector) -> Region:
        """Use the successive cut values: at most the cut goes left, above it right."""
        region = self.root
        while region.children is not None:
            left, right = region.children
            region = left if situation[region.dimension] <= region.value else right
        return region

    def progress(self, region: Region) -> float:
        """LP = -(Em(t) - Em(t - DELAY)), in the region's own time."""
        if len(region.errors) < self.window + self.delay:
            return 0.0
        now = region.errors[-self.window :]
        then = region.errors[-self.window - self.delay : len(region.errors) - self.delay]
        return -(sum(now) / self.window - sum(then) / self.window)

    def choose(self, candidates: Sequence[Vector]) -> int:
        """Return the first candidate whose region has the highest progress."""
        worth = [self.progress(self.region_of(candidate)) for candidate in candidates]
        return worth.index(max(worth))

    def predict(self, region: Region, situation: Vector) -> list[float]:
        """Return the mean outcome of the k nearest examples, the older first among equals."""
        if not region.examples:
            return [0.5]
        by_distance = sorted(
            region.examples,
            key=lambda example: sum(
                (a - b) ** 2 for a, b in zip(example[0], situation, strict=True)
            ),
        )
        nearest = [outcome for _, outcome in by_distance[: self.k]]
        return [sum(column) / len(nearest) for column in zip(*nearest, strict=True)]

    def observe(self, situation: Vector, outcome: Vector) -> tuple[int, list[float], float, float]:
        """Predict, then learn; return region, prediction, error and the progress before."""
        region = self.region_of(situation)
        prediction = self.predict(region, situation)
        progress = self.progress(region)
        differences = [abs(p - o) for p, o in zip(prediction, outcome, strict=False)]
        if self.squared:
            differences = [difference**2 for difference in differences]
        error = sum(differences) / len(differences)
        region.errors.append(error)
        region.examples.append((situation, outcome))
        if len(region.examples) > self.max_examples:  # C1
            self.split(region)
        return region.number, prediction, error, progress

    def split(self, region: Region) -> None:
        """Cut the region by C2, or, if no cut is admissible, forget its oldest example."""
        cut = best_cut(region.examples, self.balance)
        if cut is None:
            region.examples.pop(0)
            return
        region.dimension, region.value = cut
        region.children = Region(self.n_regions), Region(self.n_regions + 1)
        self.n_regions += 2
        for example in region.examples:
            above = example[0][region.dimension] > region.value
            region.children[above].examples.append(example)
        for child in region.children:
            child.errors = list(region.errors) if self.inherit_history else []


def best_cut(examples: Sequence[tuple[Vector, Vector]], balance: float) -> tuple[int, float] | None:
    """C2: try every cut of every dimension; exact arithmetic, so that ties are ties."""
    best: tuple[Fraction, int, float] | None = None
    for dimension in range(len(examples[0][0])):
        ordered = sorted(examples, key=lambda example: example[0][dimension])
        outcomes = [[int(y * GRID) for y in outcome] for _, outcome in ordered]
        for n_left in range(1, len(ordered)):
            low, high = ordered[n_left - 1][0][dimension], ordered[n_left][0][dimension]
            smaller = min(n_left, len(ordered) - n_left)
            if low == high or smaller / len(ordered) < balance:
                continue
            left, right = outcomes[:n_left], outcomes[n_left:]
            score = squared_deviations(left) + squared_deviations(right)
            if best is None or score < best[0]:
                best = (score, dimension, (low + high) / 2)
    return None if best is None else best[1:]


def squared_deviations(outcomes: Sequence[Sequence[int]]) -> Fraction:
    """Return the sum of squared deviations from the mean, summed over outcome dimensions."""
    n = len(outcomes)
    return sum(
        (Fraction(n * sum(y * y for y in column) - sum(column) ** 2, n))
        for column in zip(*outcomes, strict=True)
    ) + Fraction(0)
