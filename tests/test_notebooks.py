"""The notebooks run, small; what they show in the repository is whole, clean and not large."""

import re
from pathlib import Path

import pytest

for package in ("ipykernel", "nbclient", "pandas"):
    pytest.importorskip(package, reason="the extra `notebooks` is not installed")

import nbformat  # noqa: E402
from nbformat import NotebookNode  # noqa: E402

from scripts.docs.run_notebooks import execute, notebooks, tidy  # noqa: E402

PATHS = [pytest.param(path, id=path.stem) for path in notebooks()]

MOST_BYTES = 1_000_000
"""A notebook that is larger takes long to show."""

KERNEL = {"name": "python3", "display_name": "Python 3"}

PLACE = re.compile(r"(?<![\w.])/(home|root|tmp|Users|var|work)/")
"""A place on somebody's machine."""


def read(path: Path) -> NotebookNode:
    notebook: NotebookNode = nbformat.read(path, as_version=4)
    return notebook


def code_cells(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def outputs(notebook: NotebookNode) -> list[NotebookNode]:
    return [output for cell in code_cells(notebook) for output in cell.outputs]


def pictures(notebook: NotebookNode) -> int:
    return sum("image/png" in output.get("data", {}) for output in outputs(notebook))


def complaints(notebook: NotebookNode) -> list[str]:
    """Return what was not meant to be shown: warnings, errors."""
    return [
        str(output.get("text", output.get("traceback")))
        for output in outputs(notebook)
        if output.output_type == "error" or output.get("name") == "stderr"
    ]


def test_there_are_notebooks() -> None:
    assert [path.name[:2] for path in notebooks()] == ["01", "02", "03", "04", "05"]


@pytest.mark.parametrize("path", PATHS)
def test_a_notebook_runs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SMOKE_TEST", "1")
    notebook = execute(path)
    tidy(notebook)
    assert complaints(notebook) == []
    assert pictures(notebook) == pictures(read(path))


@pytest.mark.parametrize("path", PATHS)
def test_what_a_notebook_shows_is_of_one_clean_run(path: Path) -> None:
    notebook = read(path)
    counts = [cell.execution_count for cell in code_cells(notebook)]
    assert counts == list(range(1, len(counts) + 1))
    assert complaints(notebook) == []
    assert pictures(notebook) >= 3
    assert path.stat().st_size < MOST_BYTES
    assert not PLACE.search(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", PATHS)
def test_a_notebook_begins_with_its_subject_and_ends_with_what_to_try(path: Path) -> None:
    first, *_, last = read(path).cells
    assert first.cell_type == last.cell_type == "markdown"
    assert re.match(r"# .+\n", first.source)
    assert "You will see" in first.source
    assert "## What to try next" in last.source


@pytest.mark.parametrize("path", PATHS)
def test_links_lead_somewhere(path: Path) -> None:
    text = "\n".join(cell.source for cell in read(path).cells if cell.cell_type == "markdown")
    links = re.findall(r"\]\((?!http)([^)#]+)\)", text)
    assert links
    assert [link for link in links if not (path.parent / link).exists()] == []


def test_a_slider_works_in_the_page_as_it_is() -> None:
    """Its pictures are in the page; a widget would need a running notebook."""
    notebook = read(notebooks()[0])
    (page,) = (
        html
        for output in outputs(notebook)
        if "animation" in (html := "".join(output.get("data", {}).get("text/html", "")))
    )
    assert page.count("data:image/png;base64") >= 10
    assert 'type="range"' in page
    assert not any(
        "widget" in kind for output in outputs(notebook) for kind in output.get("data", {})
    )


def test_what_a_notebook_keeps_about_the_machine_is_left_out() -> None:
    notebook = nbformat.v4.new_notebook(
        metadata={"kernelspec": KERNEL, "language_info": {"name": "python", "version": "3"}}
    )
    tidy(notebook)
    assert list(notebook.metadata) == ["kernelspec"]
