"""Which modules may import which, and what an import may cost."""

import ast
import re
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PACKAGES = ("analytic", "augment", "foundation", "siamloc")
OUTER = (
    *("siamloc.evaluation", "siamloc.report", "siamloc.runtime", "siamloc.simulate", "siamloc.pretraining"),
    "siamloc.reproduce",
)
FORBIDDEN = {
    "analytic": ("augment", "siamloc"),
    "augment": ("analytic", "siamloc"),
    "foundation": ("analytic", "augment", "siamloc"),
    "siamloc.data": (*OUTER, "siamloc.models", "siamloc.training", "siamloc.maps"),
    "siamloc.models": (*OUTER, "siamloc.data", "siamloc.training", "siamloc.maps"),
    "siamloc.training": (*OUTER, "siamloc.maps"),
    "siamloc.maps": (*OUTER, "siamloc.training"),
    "siamloc.reproduce": ("siamloc.runtime", "siamloc.simulate", "siamloc.pretraining", "siamloc.report.page"),
    "siamloc.runtime": ("siamloc.evaluation", "siamloc.report", "siamloc.simulate", "siamloc.training"),
    "siamloc.evaluation": ("siamloc.report.page", "siamloc.runtime", "siamloc.simulate", "siamloc.training"),
    "siamloc.report": ("siamloc.evaluation", "siamloc.models", "siamloc.runtime", "siamloc.simulate"),
    "siamloc.report.draw": ("siamloc.maps", "siamloc.training", "siamloc.report.page"),
    "siamloc.simulate": (*OUTER[:3], "siamloc.pretraining", "siamloc.models", "siamloc.training", "siamloc.maps"),
    "siamloc.pretraining": (*OUTER[:3], "siamloc.maps"),
}
MODULES = [path.relative_to(ROOT) for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path, *, for_types=False):
    """Names that a module imports while it runs, or also those that only the type checker sees."""
    names = []
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test) and not for_types:
            node.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


def within(name, package):
    return name == package or name.startswith(f"{package}.")


def test_class_variables_have_a_type():
    """Python 3.10 cannot read the annotations of a class with a plain ClassVar."""
    texts = {path: (ROOT / path).read_text(encoding="utf-8") for path in MODULES}
    assert not [str(path) for path, text in texts.items() if re.search(r": ClassVar\b(?!\[)", text)]


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_arrows_between_packages(path):
    module = ".".join(path.with_suffix("").parts)
    names = imported(path)
    for package, others in FORBIDDEN.items():
        if within(module, package):
            wrong = [name for name in names for other in others if within(name, other)]
            assert not wrong, f"{module} must not import {wrong}"
    if not within(module, "siamloc.cli") and not within(module, "siamloc.jobs"):
        assert not [name for name in names if within(name, "siamloc.jobs")], f"{module} must not import the jobs"
    if not within(module, "siamloc.cli") and module != "siamloc.__main__":
        assert not [name for name in names if within(name, "siamloc.cli")], f"{module} must not import the CLI"


@pytest.mark.parametrize(
    "statement",
    [
        "import siamloc.data, siamloc.models, siamloc.training, siamloc.maps, siamloc.evaluation",
        "import siamloc.simulate, siamloc.runtime, siamloc.report",
        "import analytic",
        "import augment",
        "import siamloc.cli, siamloc.jobs.evaluate, siamloc.jobs.train",
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
    stub = ROOT / package / "__init__.pyi"  # lists the names that are loaded on first use
    imports = ast.parse(stub.read_text(encoding="utf-8")).body if stub.is_file() else []
    parts = [one for one in imports if isinstance(one, ast.ImportFrom) and one.module]
    names = {alias.name for one in parts for alias in one.names}
    modules = {path.stem for path in (ROOT / package).iterdir()}
    assert not names & modules, f"importing these modules of {package} would hide the names"


def test_declared_is_what_is_imported():
    """Torch's exporter needs `onnx` and `onnxscript`, Lightning's logger `tensorboard`, without being named."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    extras = project["optional-dependencies"]
    parts = ("robot", "train", "simulate", "live", "recordings")
    declared = [*project["dependencies"], *(one for part in parts for one in extras[part])]
    names = {re.match(r"[A-Za-z0-9-]+", one)[0].lower() for one in declared}
    found = {name.split(".")[0] for path in MODULES for name in imported(path)}
    found -= {*sys.stdlib_module_names, *PACKAGES, "faiss"}
    distributions = {
        "PIL": "pillow",
        "cv2": "opencv-python-headless",
        "hydra": "hydra-core",
        "lazy_loader": "lazy-loader",
        "pytorch_metric_learning": "pytorch-metric-learning",
        "sklearn": "scikit-learn",
        "yaml": "pyyaml",
    }
    used = {distributions.get(name, name) for name in found}
    assert used - names == set()
    assert names - used == {"onnx", "onnxscript", "tensorboard", "siamloc"}


def test_there_are_no_import_circles_not_even_lazy_ones():
    """Imports inside functions and for types alone count too; a package stands for its `__init__`."""
    modules = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in MODULES}
    imports = {}
    for module, path in modules.items():
        names = {name for name in imported(path, for_types=True) if name in modules}
        # `from package import module` names the package as well, which runs first and may be what imports us.
        parents = {module.rsplit(".", count)[0] for count in range(1, module.count(".") + 1)}
        imports[module] = names - parents - {module}
    order = TopologicalSorter(imports)
    try:
        order.prepare()
    except CycleError as error:
        pytest.fail(f"import circle: {' -> '.join(error.args[1])}")
