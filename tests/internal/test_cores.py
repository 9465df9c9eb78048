"""How many processor cores there are."""

import os

import pytest

from torch_iac.internal.cores import n_cores


def test_it_is_as_many_as_the_process_may_use_or_as_there_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert n_cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    for known, found in ((8, 8), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda known=known: known)
        assert n_cores() == found
