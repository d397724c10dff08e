"""What stands twice agrees: profiles, versions, stub and module; the notebook runs."""

import ast
import dataclasses
import inspect
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

import wcal
from conftest import ROOT

try:
    import tomllib
except ImportError:
    import tomli as tomllib

PYTHON = ROOT / "python"


def toml(path):
    return tomllib.loads((ROOT / path).read_text(encoding="utf-8"))


def unequal(root, own, packages):
    """Profiles and versions of the two workspaces that do not agree."""
    wrong = []
    for name in ("dev", "release"):
        one, other = (dict(of["profile"][name]) for of in (root, own))
        all_of, ours = one.pop("package", {}), other.pop("package", {})
        used = {key: value for key, value in all_of.items() if key == "*" or key in packages}
        wrong += [name] if one != other else []
        wrong += [key for key in used.keys() | ours.keys() if used.get(key) != ours.get(key)]
    for key in ("version", "edition", "rust-version", "license"):
        if root["workspace"]["package"][key] != own["package"][key]:
            wrong.append(key)
    return wrong


def test_profiles_and_versions_are_those_of_the_other_crates():
    root, own = toml("Cargo.toml"), toml("python/Cargo.toml")
    locked = {(p["name"], p["version"]) for p in toml("python/Cargo.lock")["package"]}
    packages = {name for name, _ in locked}
    assert unequal(root, own, packages) == []
    # What both use is of one version.
    others = {p["name"]: set() for p in toml("Cargo.lock")["package"]}
    for package in toml("Cargo.lock")["package"]:
        others[package["name"]].add(package["version"])
    assert [(n, v) for n, v in locked if n in others and v not in others[n]] == []
    # Negative control.
    own["profile"]["dev"]["package"]["wcal-verify"]["opt-level"] = 0
    own["package"]["version"] = "9.9.9"
    assert unequal(root, own, packages) == ["wcal-verify", "version"]


def stubbed(text):
    """Names of the stub: parameters of functions, fields and methods of classes."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef):
            found[node.name] = [a.arg for a in node.args.args + node.args.kwonlyargs]
        elif isinstance(node, ast.ClassDef):
            fields = [n.target.id for n in node.body if isinstance(n, ast.AnnAssign)]
            found[node.name] = fields + [n.name for n in node.body if isinstance(n, ast.FunctionDef)]
    return found


def disagreements(stub):
    """Public names whose stub says something else than the module."""
    wrong = []
    for name in wcal.__all__:
        real, said = getattr(wcal, name), stub.get(name)
        if said is None:
            wrong.append(name)
        elif inspect.isfunction(real):
            parameters = inspect.signature(real).parameters.values()
            if said != [p.name for p in parameters if p.kind != p.VAR_KEYWORD]:
                wrong.append(name)
        else:
            of_data = dataclasses.fields(real) if dataclasses.is_dataclass(real) else []
            fields = [f.name for f in of_data]
            lacking = [f for f in fields if f not in said]
            unknown = [n for n in said if n not in fields and not hasattr(real, n) and n != "document"]
            wrong += [name] if lacking or unknown else []
    return wrong


def test_the_stub_says_what_the_module_has():
    text = (Path(wcal.__file__).parent / "__init__.pyi").read_text(encoding="utf-8")
    assert disagreements(stubbed(text)) == []
    assert (Path(wcal.__file__).parent / "py.typed").exists()
    assert all(inspect.getdoc(getattr(wcal, name)) for name in wcal.__all__)
    # Negative control.
    other = text.replace("stimulus: str", "sugar: str").replace("exit_meaning", "meaning")
    assert disagreements(stubbed(other)) == ["Result", "verify"]


def run(notebook):
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(PYTHON)}}).execute()


def test_the_notebook_runs():
    notebook = nbformat.read(PYTHON / "example.ipynb", as_version=4)
    run(notebook)
    shown = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    assert any("<iframe" in o.get("data", {}).get("text/html", "") for o in shown)
    # Negative control: a cell that fails.
    notebook.cells = [nbformat.v4.new_code_cell("import wcal; wcal.verify(3)")]
    with pytest.raises(CellExecutionError, match="WcalError"):
        run(notebook)
