"""Runs are the same to the bit under whatever makes libraries round as on another processor.

`tests/golden.py` has the runs; what networks learn alone and in company is checked with them, since
to begin a process takes longer than either.
"""

import json
import os
import subprocess
import sys

import pytest
import torch

from tests.golden import FILE, RUNS, digest

SETTINGS = [
    {"ATEN_CPU_CAPABILITY": "default", "MKL_CBWR": "COMPATIBLE", "NUMBA_CPU_NAME": "generic"},
    {"ATEN_CPU_CAPABILITY": "avx2", "MKL_CBWR": "AVX2", "OMP_NUM_THREADS": "1"},
    {"ATEN_CPU_CAPABILITY": "avx512", "MKL_CBWR": "COMPATIBLE", "OMP_NUM_THREADS": "2"},
]
LEVELS = ["DEFAULT", "AVX2", "AVX512"]
"""What torch uses of an x86-64 processor, from the least to the most."""

EXPECTED = json.loads(FILE.read_text(encoding="utf-8"))


def is_there(capability: str) -> bool:
    """Whether the processor has what torch would be told to use; it would crash without it."""
    has = torch.backends.cpu.get_cpu_capability()
    return has in LEVELS and LEVELS.index(capability.upper()) <= LEVELS.index(has)


@pytest.mark.parametrize("name", RUNS)
def test_a_golden_run_comes_out_as_written(name: str) -> None:
    assert digest(name, 2_000) == EXPECTED[name]["2000"]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: "-".join(settings.values()))
def test_golden_runs_come_out_as_written_under_other_settings(settings: dict[str, str]) -> None:
    if not is_there(settings["ATEN_CPU_CAPABILITY"]):
        pytest.skip(f"this processor lacks {settings['ATEN_CPU_CAPABILITY']}")
    done = subprocess.run(
        [sys.executable, "-m", "tests.golden", "--steps", "300", "--company"],
        env=os.environ | settings,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {name: {"300": of["300"]} for name, of in EXPECTED.items()}
