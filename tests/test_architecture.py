"""Who may import whom, and what an import may cost."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("analytic", "augment", "siamloc")
FORBIDDEN = {
    "analytic": ("augment", "siamloc"),
    "augment": ("analytic", "siamloc"),
    "siamloc.data": ("siamloc.models", "siamloc.maps", "siamloc.evaluation", "siamloc.report", "siamloc.runtime"),
    "siamloc.models": ("siamloc.data", "siamloc.maps", "siamloc.evaluation", "siamloc.report", "siamloc.runtime"),
    "siamloc.maps": ("siamloc.evaluation", "siamloc.report", "siamloc.runtime"),
    "siamloc.evaluation": ("siamloc.report", "siamloc.runtime"),
}
MODULES = [path.relative_to(ROOT) for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path):
    """Names that a module imports while it runs; what only the type checker sees does not count."""
    names = []
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            node.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


def within(name, package):
    return name == package or name.startswith(f"{package}.")


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_arrows_between_packages(path):
    module = ".".join(path.with_suffix("").parts)
    names = imported(path)
    for package, others in FORBIDDEN.items():
        if within(module, package):
            wrong = [name for name in names for other in others if within(name, other)]
            assert not wrong, f"{module} must not import {wrong}"
    if not within(module, "siamloc.cli") and module != "siamloc.__main__":
        assert not [name for name in names if within(name, "siamloc.cli")], f"{module} must not import the CLI"


@pytest.mark.parametrize(
    "statement",
    [
        "import siamloc.data, siamloc.models, siamloc.maps, siamloc.evaluation, siamloc.runtime, siamloc.report",
        "import analytic",
        "import augment",
        "import siamloc.cli",
        "from siamloc.runtime import Localizer",
    ],
)
def test_importing_loads_neither_torch_nor_other_heavy_things(statement):
    code = f"import sys; {statement}; print([m for m in {HEAVY} if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert loaded.stdout.strip() == "[]"


HEAVY = ("torch", "torchvision", "lightning", "matplotlib", "pandas", "hydra")


def test_every_package_is_typed():
    assert all((ROOT / package / "py.typed").is_file() for package in PACKAGES)


@pytest.mark.parametrize("package", sorted({path.parent for path in MODULES if path.name == "__init__.py"}), ids=str)
def test_no_public_name_is_that_of_a_module_which_would_hide_it(package):
    tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and "_HOMES" in ast.dump(node) and isinstance(node.value, ast.Dict):
            homes = zip(node.value.keys, node.value.values, strict=True)
            names |= {name.value for name, home in homes if home.value}
    modules = {path.stem for path in (ROOT / package).iterdir()}
    assert not names & modules, f"importing these modules of {package} would hide the names"
