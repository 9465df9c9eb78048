"""The devices of this machine."""

import torch


def available_device(device: torch.device | str) -> torch.device:
    """Return a device that this machine has.

    Raises:
        ValueError: It has no such device.
    """
    try:
        probe = torch.zeros(1, device=device)
        probe.item()  # a device without memory, such as "meta", has no answer
        return probe.device
    except (RuntimeError, AssertionError, ImportError):
        raise ValueError(f"device must be one that this machine has, got {device}") from None
