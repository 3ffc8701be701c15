"""Grey-box estimation: declare a model structure once, fit it, know how far to believe the answer.

Declare a model as a `TransferFunction` or a `StateSpace` with `Parameter`s, state a `Problem`
(model, data, criterion), `fit` it, and print the `Fit`. These are its namespaces:

| namespace | contents |
| --- | --- |
| `greybox.data` | records, frequency responses, and their files |
| `greybox.logs` | flight logs |
| `greybox.spectral` | from records to frequency responses |
| `greybox.modeling` | models and the readings of their formulas |
| `greybox.formulation` | problems and criteria |
| `greybox.regression` | estimates by linear least squares |
| `greybox.solve` | starts and solvers |
| `greybox.simulation` | simulation and prediction |
| `greybox.validation` | tests between models |
| `greybox.experiment` | test signals, controllers, virtual flights, planning of flight tests |
| `greybox.interop` | other libraries and languages |
| `greybox.identification` | from a log to a model in one call |
| `greybox.study` | batches of fits and the bootstrap |
| `greybox.plotting` | figures |
"""

import ast as _ast
import sys as _sys
from importlib import import_module as _import_module
from importlib.abc import Loader as _Loader, MetaPathFinder as _MetaPathFinder
from importlib.machinery import ModuleSpec as _ModuleSpec
from pathlib import Path as _Path
from types import ModuleType as _ModuleType
from typing import Any as _Any

from greybox.data.files.version import __version__ as __version__


def _public_names() -> dict[str, str]:
    """Read the module of every public name from the stub file, which type checkers read too."""
    stub = _Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    imports = [node for node in _ast.parse(stub).body if isinstance(node, _ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


_MODULES = _public_names()


# The namespaces among them, with the names of their folders.
_FOLDERS = {
    name: f"{module}.{name}"
    for name, module in _MODULES.items()
    if _Path(__file__).parents[1].joinpath(*module.split("."), name, "__init__.py").is_file()
}


class _Namespaces(_MetaPathFinder, _Loader):
    """Finds ``greybox.spectral`` where the folder stands, ``greybox.spectral``."""

    def find_spec(self, fullname: str, path: _Any = None, target: _Any = None) -> _Any:
        package, _, inside = fullname.partition(".")
        name, _, rest = inside.partition(".")
        if package != __name__ or name not in _FOLDERS or _FOLDERS[name] == f"{package}.{name}":
            return None
        # A file within has one name alone: two would be two modules.
        if rest:
            raise ModuleNotFoundError(f"{fullname} is {_FOLDERS[name]}.{rest}.", name=fullname)
        return _ModuleSpec(fullname, self, loader_state=_FOLDERS[name])

    def create_module(self, spec: _ModuleSpec) -> _ModuleType:
        module = _import_module(spec.loader_state)
        # The import system gives the module the specification that it has asked for.
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: _ModuleType) -> None:
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state


_sys.meta_path.insert(0, _Namespaces())


def __getattr__(name: str) -> object:
    """Import a public name at its first use: everything at once takes a second."""
    if name not in _MODULES:
        raise AttributeError(f"module 'greybox' has no attribute {name!r}")

    if name in _FOLDERS:
        value = _import_module(_FOLDERS[name])
    else:
        value = getattr(_import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, those not yet imported included."""
    return sorted([*_MODULES, "__version__"])


# In a clone, models/ and problems/ stand beside this package; in a wheel they are inside it.
if not (_Path(__file__).parent / "models").is_dir():
    __path__.append(str(_Path(__file__).parents[1]))
