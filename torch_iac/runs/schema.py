"""What a run folder holds: the names of files, columns and rows.

Shapes: `T` decisions, `A` agents, `Z` zones, `W` windows of decisions, `R` regions of an agent, `P`
points of a curve.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from torch_iac.records import Genealogy
from torch_iac.regions.tree import NONE
from torch_iac.space import Dimension, SensorimotorSpace

MAIN = "main"
"""Name of the robot's own experts beside their shadows."""

RESERVED = (MAIN, "mean", "expected")
"""Names that a shadow cannot have, since other errors have them."""

USED_NETWORK = "used_network"
"""The column that says whether hybrid experts used the network."""

CONFIG = "config.json"
STEPS = "steps"
WINDOWS = "windows"
REGIONS = "regions.parquet"
SUMMARY = "summary.json"
CHECKPOINTS = "checkpoints"
EVENTS = "events.out.tfevents.*"
"""Names of the files and folders in a run folder; the last are TensorBoard's."""

WINDOW = 250
"""Decisions in a window: by default, and in the sums that runs keep of all agents."""


def region_table(genealogy: Genealogy, space: SensorimotorSpace) -> pa.Table:
    """Return the rows of `regions.parquet`: cuts by name and in raw units, null for leaves."""
    cut = genealogy.cut_dimension.numpy()
    is_leaf = cut == NONE
    low = np.array([dimension.low for dimension in space.situation])[cut]
    high = np.array([dimension.high for dimension in space.situation])[cut]
    value = low + genealogy.cut_value.double().numpy() * (high - low)
    name = np.array(space.situation_names, dtype=object)[cut]
    return pa.table(
        {
            "agent": pa.array(genealogy.agent.numpy(), pa.int32()),
            "region": pa.array(genealogy.region.numpy(), pa.int32()),
            "parent": pa.array(genealogy.parent.numpy(), pa.int32()),
            "depth": pa.array(genealogy.depth.numpy(), pa.int32()),
            "born_step": pa.array(genealogy.born_step.numpy(), pa.int64()),
            "split_step": pa.array(genealogy.split_step.numpy(), pa.int64()),
            "cut_dimension": pa.array(name, pa.string(), mask=is_leaf),
            "cut_value": pa.array(value, pa.float64(), mask=is_leaf),
            "n_examples": pa.array(genealogy.n_examples.numpy(), pa.int32()),
        }
    )


def column_names(space: SensorimotorSpace, is_hybrid: bool = False) -> dict[str, list[str]]:
    """Return the columns that each field of a step fills, in the order of the file.

    Args:
        space: What the robots do, sense and predict.
        is_hybrid: Whether the experts are hybrid.
    """

    def each(kind: str, dimensions: Sequence[Dimension]) -> list[str]:
        return [f"{kind}/{dimension.name}" for dimension in dimensions]

    return {
        "random_actions": ["random_action"],
        "actions": each("action", space.actions),
        "sensors": each("sensor", space.sensors),
        "outcomes": each("outcome", space.outcomes),
        "predictions": each("prediction", space.outcomes),
        "errors": ["error"],
        "expected_errors": ["expected_error"],
        "regions": ["region"],
        "progress": ["progress"],
        **({USED_NETWORK: [USED_NETWORK]} if is_hybrid else {}),
    }


def shadow_names(space: SensorimotorSpace, shadows: Sequence[str]) -> dict[str, list[str]]:
    """Return the columns that the predictions and the errors of each shadow fill, in order."""
    names = {}
    for shadow in shadows:
        predictions = f"shadow/{shadow}/prediction"
        names[predictions] = [f"{predictions}/{outcome.name}" for outcome in space.outcomes]
        names[shadow_error(shadow)] = [shadow_error(shadow)]
    return names


def part_path(folder: Path, number: int, kind: str = STEPS) -> Path:
    """Return where a run folder keeps a part of its `STEPS` or `WINDOWS`; parts count from 0."""
    return folder / kind / f"part-{number:05d}.parquet"


def shadow_error(name: str) -> str:
    """Return the column that holds the errors of a shadow."""
    return f"shadow/{name}/error"


def summed_fields(shadows: Sequence[str], is_hybrid: bool = False) -> list[str]:
    """Return the columns of the steps that windows sum up."""
    fields = ["error", "expected_error", "progress", *map(shadow_error, shadows)]
    return [*fields, USED_NETWORK] if is_hybrid else fields


def sum_columns(columns: Sequence[str], zone_names: Sequence[str]) -> list[list[str]]:
    """Return the columns of the counts, then of the sums of each column, zone by zone.

    Args:
        columns: What is summed up.
        zone_names: The world's zones; without any, one name stands for all.
    """
    ends = [f"/{zone}" for zone in zone_names] or [""]
    kinds = ["decisions", *(f"{column}_sum" for column in columns)]
    return [[f"{kind}{end}" for end in ends] for kind in kinds]
