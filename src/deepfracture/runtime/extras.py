"""Libraries that not everybody needs: named in one line when they are missing, with the pip line that brings them."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from deepfracture.runtime.progress import log
from deepfracture.types import BadInput


def is_installed(module: str) -> bool:
    """Whether `module` is installed; it is not imported, so that asking costs nothing."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of a dotted name, the package itself is missing
        return False


def skip_unless_installed(file: str, module: str, *, extra: str) -> bool:
    """Whether `file` cannot be written as `module` is missing; says so in one line of the log."""
    if is_installed(module):
        return False
    log.warning("%s left out: %s makes it", file, pip_command(extra))
    return True


def pip_command(*extras: str) -> str:
    """What to type to install `extras` of this program."""
    return f"pip install 'deepfracture[{','.join(extras)}]'"


def require(module: str, *, extra: str, to: str) -> ModuleType:
    """Import an optional library, on first use.

    Args:
        module: Name to import, dots allowed.
        extra: Extra of this program that installs it, as in pyproject.toml.
        to: What it is needed for, after "to": "play in the browser".

    Raises:
        BadInput: It is not installed, or does not load; says which and what to type.
    """
    library = module.partition(".")[0]
    if not is_installed(library):
        raise BadInput(f"{library} is needed to {to} and is not installed: {pip_command(extra)}")
    try:
        return import_module(module)
    except ImportError as error:
        reason = str(error).strip().split("\n")[0]
        raise BadInput(
            f"{library} is needed to {to}, is installed and does not load ({reason}): "
            f"{pip_command(extra)} --force-reinstall, or see `deepfracture doctor`"
        ) from error
