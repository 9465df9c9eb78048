"""Draw the pictures of a run that the documentation shows.

    torch-iac train --out runs/first
    python -m scripts.docs.draw_run runs/first

draws `experts.png`, `tree.png`, `zones.png` and `partition.png` into `docs/images/`.
"""

from dataclasses import dataclass
from pathlib import Path

import tyro

from torch_iac.analysis.family_tree import draw_experts, draw_tree
from torch_iac.analysis.figures import draw_zones
from torch_iac.analysis.maps import draw_partition
from torch_iac.analysis.style import save
from torch_iac.runs.reader import load_run

MOMENTS = (300, 1000, 5000)
"""Decisions at which the space is shown."""


@dataclass(frozen=True)
class Options:
    """Which run, and where its pictures go."""

    run_folder: tyro.conf.Positional[Path]
    """The run, of more than 5,000 decisions."""
    out: Path = Path("docs/images")
    """The folder of the pictures."""


def main(options: Options) -> None:
    """Draw a run."""
    run = load_run(options.run_folder)
    save(draw_experts(run), options.out / "experts.png")
    save(draw_tree(run), options.out / "tree.png")
    save(draw_zones(run), options.out / "zones.png")
    partition = draw_partition(run, MOMENTS, across="sound", up="left_wheel")
    save(partition, options.out / "partition.png")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
