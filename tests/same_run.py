"""Are two runs the same, to the bit? What runs that were killed and resumed are held against."""

from pathlib import Path
from typing import Any

from safetensors.numpy import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torch_iac.runs.reader import load_run
from torch_iac.runs.schema import CHECKPOINTS


def differences(one: Path, other: Path) -> list[str]:
    """Return in what two runs differ: files, tensors in the last checkpoint, TensorBoard's tags."""
    first, second = contents(one), contents(other)
    missing = object()
    names = first.keys() | second.keys()
    return sorted(n for n in names if first.get(n, missing) != second.get(n, missing))


def contents(folder: Path) -> dict[str, Any]:
    """Return what a run has come to, whenever and however fast it was."""
    run = load_run(folder)
    summary = {name: value for name, value in run.summary.items() if "second" not in name}
    windows = run.window_sums.counts.tobytes() + run.window_sums.sums["error"].tobytes()
    found = {"steps": run.steps, "regions": run.regions, "summary": summary, "windows": windows}
    last = max((folder / CHECKPOINTS).glob("*/state.safetensors"))
    for name, tensor in load_file(last).items():
        if name.startswith(("agent/", "world/")):
            found[name] = (tensor.dtype, tensor.shape, tensor.tobytes())
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0, "images": 0})
    events.Reload()
    for tag in events.Tags()["scalars"]:
        found[tag] = [(event.step, event.value) for event in events.Scalars(tag)]
    for tag in events.Tags()["images"]:
        found[tag] = [(event.step, event.encoded_image_string) for event in events.Images(tag)]
    return found
