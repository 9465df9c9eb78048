"""Does the system do what its papers say? Claim by claim, over many robots.

    python -m scripts.reproduce_paper

lets robots develop in the kinematic room and in pybullet's, with nearest neighbours and networks
and the drives of the papers, then prints what `scripts.claims` makes of them, as Markdown, and
draws the generalisation tests. Runs that are in the folder already are not run again;
`docs/results.md` holds a copy.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tyro

import torch_iac as iac
from scripts.study import KINEMATIC, WORLD, Life, live_all
from torch_iac.runs import Run

TEST_EVERY = 100  # decisions, as in 2007

NETWORKS = iac.MLPExperts()
MP = iac.MetaPredictor()


@dataclass(frozen=True)
class Variant:
    """Robots that are alike but for their seeds.

    Attributes:
        config: Their numbers.
        options: The arguments of their world.
        in_pybullet: Whether they live in pybullet's room as well.
    """

    config: iac.IACConfig
    options: Mapping[str, Any] = field(default_factory=dict)
    in_pybullet: bool = False


def _of_2007(drive: iac.Drive) -> Variant:
    """Return robots with that paper's numbers and senses."""
    config = replace(iac.PRESETS["iac2007"], drive=drive)
    return Variant(config, {"beams": 0, "toy_direction": False})


VARIANTS = {
    "knn": Variant(iac.IACConfig(), in_pybullet=True),
    "knn-random": Variant(iac.IACConfig(drive=iac.Random()), in_pybullet=True),
    "knn-max": Variant(iac.IACConfig(drive=iac.Error()), in_pybullet=True),
    "knn-global": Variant(iac.IACConfig(drive=iac.GlobalProgress(), meta=MP), in_pybullet=True),
    "mlp": Variant(iac.IACConfig(experts=NETWORKS), in_pybullet=True),
    "mlp-random": Variant(iac.IACConfig(experts=NETWORKS, drive=iac.Random()), in_pybullet=True),
    "mlp-max": Variant(iac.IACConfig(experts=NETWORKS, drive=iac.Error())),
    "knn-proportional": Variant(
        iac.IACConfig(drive=iac.AbsoluteProgress(), choice=iac.Proportional())
    ),
    "knn-curriculum": Variant(iac.IACConfig(drive=iac.Curriculum())),
    "mlp-curriculum": Variant(iac.IACConfig(experts=NETWORKS, drive=iac.Curriculum())),
    "2007": _of_2007(iac.Progress()),
    "2007-random": _of_2007(iac.Random()),
    "2007-max": _of_2007(iac.Error()),
}


@dataclass(frozen=True)
class Study:
    """How many robots, and for how long."""

    kinematic_seeds: int = 100
    """How many robots of each kind live in the kinematic room, with the seeds 0, 1, ..."""
    pybullet_seeds: int = 30
    """How many in pybullet's."""
    block: int = 15
    """How many of those in pybullet's room are one run."""
    steps: int = 10_000
    """How many decisions each takes."""
    out: Path = Path("runs/paper")
    """Where the run folders go."""
    processes: int = 2
    """How many runs go on at once."""


def main(study: Study) -> None:
    """Run what is not there yet, then print the claims."""
    runs_of(study)


def runs_of(study: Study) -> dict[str, dict[str, list[Run]]]:
    """Return the runs of each variant in each world; those that are not there yet are run."""
    places = list(_lives(study))
    runs = live_all([life for _, _, life in places], study.processes)
    found: dict[str, dict[str, list[Run]]] = {"kinematic": {}, "pybullet": {}}
    for (world, name, _), run in zip(places, runs, strict=True):
        found[world].setdefault(name, []).append(run)
    return found


def _lives(study: Study) -> Iterator[tuple[str, str, Life]]:
    """Return every run, with its world and its variant; those in both worlds first."""
    for name, variant in VARIANTS.items():
        seeds = range(study.kinematic_seeds)
        yield "kinematic", name, _life(study, "kinematic", name, variant, seeds)
        for first in range(0, study.pybullet_seeds if variant.in_pybullet else 0, study.block):
            seeds = range(first, min(first + study.block, study.pybullet_seeds))
            yield "pybullet", name, _life(study, "pybullet", name, variant, seeds)


def _life(study: Study, world: str, name: str, variant: Variant, seeds: range) -> Life:
    folder = study.out / world / name / f"seeds-{seeds.start:03d}-{seeds.stop - 1:03d}"
    return Life(
        folder,
        variant.config,
        seeds,
        study.steps,
        KINEMATIC if world == "kinematic" else WORLD,
        variant.options,
        TEST_EVERY,
    )


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
