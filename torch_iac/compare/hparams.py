"""What TensorBoard's HParams page shows of a comparison: a row a run.

The comparison's folder declares settings and measures, each run's folder has their values. They are
in files of their own, so that they can be rewritten.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.plugins.hparams.api_pb2 import (
    DATA_TYPE_FLOAT64,
    DATA_TYPE_STRING,
    STATUS_SUCCESS,
    Experiment,
    HParamInfo,
    MetricInfo,
    MetricName,
)
from tensorboard.plugins.hparams.metadata import (
    EXPERIMENT_TAG,
    NULL_TENSOR,
    SESSION_END_INFO_TAG,
    SESSION_START_INFO_TAG,
    create_summary_metadata,
)
from tensorboard.plugins.hparams.plugin_data_pb2 import (
    HParamsPluginData,
    SessionEndInfo,
    SessionStartInfo,
)
from torch.utils.tensorboard import FileWriter

from torch_iac.runs.schema import EVENTS

SUFFIX = ".hparams"
"""Suffix of the names of these files."""

TAG = "measures/"
"""Prefix of the tags of measures."""

SETTINGS = (
    "steps",
    "device",
    "world",
    "world_options",
    "outcomes",
    "hold",
    "encoder",
    "sensor_bounds",
    "bounds_from",
    "test_every",
)
"""Which fields of a config are settings, besides those of the robots."""

NOTHING = "none"
"""How it is written that a run has no such setting."""

Settings = Mapping[str, str | float]
"""The settings of a run, by name."""


def write_experiment(folder: Path, settings: Sequence[Settings], labels: Mapping[str, str]) -> None:
    """Declare settings and measures.

    Args:
        folder: The comparison's folder.
        settings: The settings of each run.
        labels: What each measure is, in words.
    """
    names = list(dict.fromkeys(name for of in settings for name in of))
    hparams = [_setting(name, [of[name] for of in settings if name in of]) for name in names]
    metrics = [
        MetricInfo(name=MetricName(tag=TAG + name), display_name=name, description=label)
        for name, label in labels.items()
    ]
    experiment = Experiment(hparam_infos=hparams, metric_infos=metrics)
    _write(folder, [(_tagged(EXPERIMENT_TAG, HParamsPluginData(experiment=experiment)), 0)])


def write_session(
    folder: Path, settings: Settings, measures: Mapping[str, float], n_decisions: int
) -> None:
    """Write the settings and measures of a run.

    Args:
        folder: The run's folder.
        settings: Its settings.
        measures: Its measures, under their names; NaN for those that it lacks.
        n_decisions: How many decisions it took.
    """
    values = [
        Summary.Value(tag=TAG + name, simple_value=value)
        for name, value in measures.items()
        if np.isfinite(value)
    ]
    start, end = SessionStartInfo(), SessionEndInfo(status=STATUS_SUCCESS)
    for name, value in settings.items():
        kind = "string_value" if isinstance(value, str) else "number_value"
        setattr(start.hparams[name], kind, value)
    content = [
        (_tagged(SESSION_START_INFO_TAG, HParamsPluginData(session_start_info=start)), 0),
        (Summary(value=values), n_decisions),
        (_tagged(SESSION_END_INFO_TAG, HParamsPluginData(session_end_info=end)), n_decisions),
    ]
    _write(folder, content)


def differing_settings(configs: Sequence[Mapping[str, Any]]) -> list[dict[str, str | float]]:
    """Return the settings of each config that differ between them; `NOTHING` where one has none."""
    settings = [_settings(config) for config in configs]
    kept: dict[str, Sequence[str | float]] = {}
    for name in dict.fromkeys(name for of in settings for name in of):
        values = [of.get(name) for of in settings]
        if any(value != values[0] for value in values):
            numbers = [float(value) for value in values if isinstance(value, (int, float))]
            texts = [NOTHING if value is None else str(value) for value in values]
            kept[name] = numbers if len(numbers) == len(values) else texts
    return [{name: of[place] for name, of in kept.items()} for place in range(len(configs))]


def _settings(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return what decides what a config's robots do, each under its whole name."""
    parts = {name: config[name] for name in SETTINGS if name in config}
    return _flat({**parts, **config["iac"]})


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            leaves |= _flat(value, f"{prefix}{name}.")
        else:
            leaves[f"{prefix}{name}"] = value
    return leaves


def _setting(name: str, values: Sequence[str | float]) -> HParamInfo:
    """Return what kind of setting it is, and which values it takes."""
    if isinstance(values[0], str):
        info = HParamInfo(name=name, type=DATA_TYPE_STRING)
        info.domain_discrete.extend(dict.fromkeys(map(str, values)))
        return info
    info = HParamInfo(name=name, type=DATA_TYPE_FLOAT64)
    numbers = [float(value) for value in values]
    info.domain_interval.min_value, info.domain_interval.max_value = min(numbers), max(numbers)
    return info


def _tagged(tag: str, data: HParamsPluginData) -> Summary:
    about = create_summary_metadata(data)
    return Summary(value=[Summary.Value(tag=tag, metadata=about, tensor=NULL_TENSOR)])


def _write(folder: Path, content: Sequence[tuple[Summary, int]]) -> None:
    """Write summaries, each at a step, in place of those that an earlier report wrote."""
    for path in folder.glob(EVENTS + SUFFIX):
        path.unlink()
    writer = FileWriter(str(folder), filename_suffix=SUFFIX)
    for summary, step in content:
        writer.add_summary(summary, step)
    writer.close()
