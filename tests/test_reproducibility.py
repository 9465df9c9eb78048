"""Runs are the same to the bit under whatever makes libraries round as on another processor."""

import json
import os
import subprocess
import sys

import pytest

from tests.golden import FILE, RUNS, digest

SETTINGS = [
    {"ATEN_CPU_CAPABILITY": "default", "MKL_CBWR": "COMPATIBLE", "NUMBA_CPU_NAME": "generic"},
    {"ATEN_CPU_CAPABILITY": "avx2", "MKL_CBWR": "AVX2", "OMP_NUM_THREADS": "1"},
    {"ATEN_CPU_CAPABILITY": "avx512", "OMP_NUM_THREADS": "2"},
]


@pytest.mark.parametrize("name", RUNS)
def test_a_golden_run_comes_out_as_written(name: str) -> None:
    assert digest(name, 2_000) == json.loads(FILE.read_text())[name]["2000"]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: "-".join(settings.values()))
def test_golden_runs_come_out_as_written_under_other_settings(settings: dict[str, str]) -> None:
    expected = {name: {"300": of["300"]} for name, of in json.loads(FILE.read_text()).items()}
    done = subprocess.run(
        [sys.executable, "-m", "tests.golden", "--steps", "300"],
        env=os.environ | settings,
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == expected
