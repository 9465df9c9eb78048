"""Public names are explained, and the examples in docstrings give what they say."""

import ast
import doctest
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import torch_iac
import torch_iac_envs

FILES = [
    (package.__name__, Path(str(package.__file__)).parent, path)
    for package in (torch_iac, torch_iac_envs)
    for path in sorted(Path(str(package.__file__)).parent.rglob("*.py"))
]
MODULES = {
    ".".join((name, *path.relative_to(root).with_suffix("").parts)): path.read_text()
    for name, root, path in FILES
}
EXAMPLES = [name for name, text in MODULES.items() if ">>>" in text]

ARRAY = re.compile(r"\b(Tensor|NDArray|ndarray)\b")
NAMED = re.compile(r"(tuple\[)?(dict|Mapping)\[")  # what is under names has many shapes
SHAPE = re.compile(r"\b[Ss]hape|\b[Cc]olumns\b|`\((\w+,|\.\.\.)")  # "Shape", `(A, C)` or `(...)`


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_come_out(name: str) -> None:
    if name == "torch_iac.torchrl":
        pytest.importorskip("torchrl", reason="needs TorchRL: pip install 'torch_iac[torchrl]'")
    found = doctest.testmod(import_module(name))
    assert found.attempted
    assert not found.failed


@pytest.mark.parametrize("name", MODULES)
def test_what_is_raised_is_said(name: str) -> None:
    silent = [
        f"{function.name}: {error}"
        for function, text in functions_of(MODULES[name])
        for error in raised_by(function)
        if f"{error}: " not in text.partition("Raises:\n")[2]
    ]
    assert not silent


@pytest.mark.parametrize("name", MODULES)
def test_tensors_and_arrays_have_shapes(name: str) -> None:
    silent = [
        function.name
        for function, text in functions_of(MODULES[name])
        if any(map(ARRAY.search, annotations_of(function))) and not SHAPE.search(text)
    ]
    assert not silent


@pytest.mark.parametrize("name", MODULES)
def test_constants_and_fields_are_explained(name: str) -> None:
    module = ast.parse(MODULES[name])
    owners: list[ast.Module | ast.ClassDef] = [module, *classes_of(module)]
    assert not [missing for owner in owners for missing in unsaid_in(owner)]


def test_the_rules_find_what_is_missing() -> None:
    functions = {function.name: (function, text) for function, text in functions_of(SILENT)}
    assert {name: raised_by(function) for name, (function, _) in functions.items()} == {
        "__post_init__": {"ValueError"},
        "area": set(),
    }
    area, text = functions["area"]
    assert annotations_of(area) == ["Tensor", "float"]
    assert not SHAPE.search(text)
    module = ast.parse(SILENT)
    assert list(unsaid_in(module)) == ["LEFT"]
    assert [list(unsaid_in(of)) for of in classes_of(module)] == [["height"]]


SILENT = '''
STEP = 1
SIZE = 2
"""Of both."""
LEFT = 3

class Box:
    """A box.

    Attributes:
        width: In metres.
    """

    width: float
    height: float

    def __post_init__(self) -> None:
        raise ValueError("no")

def area(of: Tensor, by: dict[str, Tensor]) -> float:
    """Return it."""
'''


# What the rules look at.


def is_public(node: ast.ClassDef | ast.FunctionDef) -> bool:
    return not node.name.startswith("_") or node.name.endswith("__")


def classes_of(module: ast.Module) -> list[ast.ClassDef]:
    return [node for node in module.body if isinstance(node, ast.ClassDef) and is_public(node)]


def functions_of(module: str) -> Iterator[tuple[ast.FunctionDef, str]]:
    """Yield public functions and methods, each with its docstring, or else that of its class."""
    for node in ast.parse(module).body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef) or not is_public(node):
            continue
        of_class = ast.get_docstring(node) or ""
        for function in [node] if isinstance(node, ast.FunctionDef) else node.body:
            if isinstance(function, ast.FunctionDef) and is_public(function):
                yield function, ast.get_docstring(function) or of_class


def raised_by(function: ast.FunctionDef) -> set[str]:
    """Return the errors in a function's own raise statements."""
    errors = [node.exc for node in ast.walk(function) if isinstance(node, ast.Raise) and node.exc]
    return {ast.unparse(of.func if isinstance(of, ast.Call) else of) for of in errors}


def annotations_of(function: ast.FunctionDef) -> list[str]:
    """Return the types of a function's arguments and of what it returns, but for mappings."""
    arguments = [*function.args.args, *function.args.kwonlyargs]
    kinds = [*(argument.annotation for argument in arguments), function.returns]
    texts = [ast.unparse(kind) for kind in kinds if kind]
    return [text for text in texts if not NAMED.match(text)]


def unsaid_in(owner: ast.Module | ast.ClassDef) -> Iterator[str]:
    """Yield public names that neither `Attributes:` nor the string below explains.

    The string may stand below several lines, and is then about all of them.
    """
    said, last_line = ast.get_docstring(owner) or "", 0
    waiting: list[str] = []
    for node in owner.body:
        follows = node.lineno == last_line + 1
        last_line = node.end_lineno or 0
        if isinstance(node, ast.Expr) and follows:
            waiting = []
        elif not follows:
            yield from waiting
            waiting = []
        waiting += [name for name in names_of(node, owner) if f"    {name}: " not in said]
    yield from waiting


def names_of(node: ast.stmt, owner: ast.Module | ast.ClassDef) -> list[str]:
    """Return the public constants or fields, class variables and loggers aside, of a statement."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or "ClassVar" in ast.unparse(node):
        return []
    if isinstance(node, ast.Assign):
        targets = [] if isinstance(owner, ast.ClassDef) else node.targets
    else:
        targets = [node.target]
    found = [of.id for target in targets for of in ast.walk(target) if isinstance(of, ast.Name)]
    return [name for name in found if not name.startswith("_") and name != "log"]
