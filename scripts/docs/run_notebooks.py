"""Run the notebooks and keep what they show.

    python -m scripts.docs.run_notebooks

executes each notebook of `notebooks/` and writes it back with its outputs, so that they can be read
without running anything. `SMOKE_TEST=1` in the environment makes the runs small, for tests.
"""

from dataclasses import dataclass
from pathlib import Path

import nbformat
import tyro
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).parents[2] / "notebooks"

MOST_SECONDS = 3600
"""A cell that takes longer is stopped."""


@dataclass(frozen=True)
class Study:
    """Which notebooks."""

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Their beginnings, such as 01; all without any."""


def main(study: Study) -> None:
    """Run notebooks and write them back."""
    for path in notebooks():
        if not study.names or path.name.startswith(study.names):
            notebook = execute(path)
            tidy(notebook)
            nbformat.write(notebook, path)
            print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


def notebooks() -> list[Path]:
    """Return where the notebooks are, in order."""
    return sorted(FOLDER.glob("*.ipynb"))


def execute(path: Path) -> NotebookNode:
    """Return a notebook as it is after all its cells have run.

    Raises:
        nbclient.exceptions.CellExecutionError: A cell failed.
    """
    notebook: NotebookNode = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=MOST_SECONDS,
        record_timing=False,
        resources={"metadata": {"path": str(FOLDER)}},
    )
    return client.execute()


def tidy(notebook: NotebookNode) -> None:
    """Leave out what differs from machine to machine."""
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"]}


if __name__ == "__main__":
    main(tyro.cli(Study))
