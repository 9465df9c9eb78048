"""What users get: the built wheel, installed where nothing of this folder can be seen."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest

import torch_iac

ROOT = Path(__file__).parents[1]
PACKAGES = {"torch_iac": ROOT / "torch_iac", "torch_iac_envs": ROOT / "envs" / "torch_iac_envs"}
LEFT_BEHIND = (".*", "__pycache__", "build", "dist", "*.egg-info")


def left_behind(folder: str, names: list[str]) -> set[str]:
    """Return what is not copied: what `LEFT_BEHIND` says, and the runs at the root."""
    left = set(shutil.ignore_patterns(*LEFT_BEHIND)(folder, names))
    return left | {"runs"} if Path(folder) == ROOT else left


def answer(*words: str | Path, where: Path) -> str:
    """Return what a command prints, started in a folder and without Python's variables."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=where,
        env=plain,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy: a build leaves files that find their way into the next."""
    folder = tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT, folder / "source", ignore=left_behind)
    build = (sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder)
    answer(*build, folder / "source", where=folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def programs(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of a fresh environment: the wheel is installed, dependencies are borrowed.

    A folder that a `.pth` file names is searched, but its own `.pth` files are not read. So what
    is installed beside the tests can be imported, but not what is only linked there, as this
    project is in development.
    """
    folder = tmp_path_factory.mktemp("clean")
    venv.create(folder, with_pip=False)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    pip = (sys.executable, "-m", "pip", "--python", programs / "python")
    answer(*pip, "install", "--no-deps", "--no-index", wheel, where=folder)
    purelib = answer(
        *(programs / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"),
        where=folder,
    )
    borrowed = {sysconfig.get_path(kind) for kind in ("purelib", "platlib")}
    (Path(purelib.strip()) / "borrowed.pth").write_text("\n".join(borrowed))
    return programs


def test_the_wheel_holds_both_packages_and_nothing_else(wheel: Path) -> None:
    names = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert names == {
        f"{package}/{path.relative_to(source).as_posix()}"
        for package, source in PACKAGES.items()
        for path in source.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {"torch_iac/py.typed", "torch_iac_envs/py.typed", "torch_iac/__init__.pyi"} <= names


def test_the_wheel_works_where_it_is_installed(programs: Path, tmp_path: Path) -> None:
    places = answer(
        programs / "python",
        *("-I", "-c", "import torch_iac as a, torch_iac_envs as b; print(a.__file__, b.__file__)"),
        where=tmp_path,
    )
    clean = programs.parent.resolve()
    for package, place in zip(PACKAGES, places.split(), strict=True):
        assert Path(place).resolve().is_relative_to(clean)
        assert Path(place).parent.name == package
    assert "Let robots develop" in answer(programs / "torch-iac", "--help", where=tmp_path)
    told = answer(programs / "torch-iac", "--version", where=tmp_path)
    assert told == f"torch-iac {torch_iac.__version__}\n"
    assert answer(programs / "python", "-m", "torch_iac", "--version", where=tmp_path) == told
    report = answer(programs / "torch-iac", "train", "--steps", "300", where=tmp_path)
    assert "The robot took 300 decisions" in report
    (run,) = (tmp_path / "runs").iterdir()
    assert (run / "summary.json").is_file()
