"""Python where only the packages of siamloc's dependencies, and of the extras that one names, can be imported."""

import subprocess
import sys
from importlib.metadata import distribution, packages_distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
ONLY = """
import sys
from importlib.machinery import BuiltinImporter, FrozenImporter, PathFinder


class Installed(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        there = name.partition(".")[0] in {*sys.stdlib_module_names, *OURS}
        return super().find_spec(name, path, target) if there else None


sys.meta_path[:] = [BuiltinImporter, FrozenImporter, Installed]
"""


def printed(code: str, *extras: str) -> str:
    """Run code with the packages that pyproject.toml names, and those that they need; return what it prints."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(one for extra in extras for one in project["optional-dependencies"][extra])]
    needed = set()
    while wanted:
        one = Requirement(wanted.pop())
        if canonicalize_name(one.name) not in needed and (one.marker is None or one.marker.evaluate({"extra": ""})):
            needed.add(canonicalize_name(one.name))
            wanted += distribution(one.name).requires or []
    modules = [
        module for module, names in packages_distributions().items() if needed & set(map(canonicalize_name, names))
    ]
    only = f"OURS = {['siamloc', 'analytic', 'augment', 'foundation', *modules]}\n{ONLY}"
    command = [sys.executable, "-W", "error", "-c", only + code]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout
