"""Optional libraries: a missing one is named in one line, with the pip command that installs it."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from deepfracture.runtime.progress import log
from deepfracture.types import BadInput


def is_installed(module: str) -> bool:
    """Whether `module` is installed; does not import it, so the check is cheap."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # a dotted name whose package is missing
        return False


def skip_unless_installed(file: str, module: str, *, extra: str) -> bool:
    """Whether to skip writing `file` because `module` is not installed; logs a warning if so."""
    if is_installed(module):
        return False
    log.warning("%s skipped: %s is not installed (%s)", file, module.partition(".")[0], pip_command(extra))
    return True


def pip_command(*extras: str) -> str:
    """The command that installs `extras` of this package."""
    return f"pip install 'deepfracture[{','.join(extras)}]'"


def require(module: str, *, extra: str, to: str) -> ModuleType:
    """Import an optional library on first use.

    Args:
        module: Name to import, may be dotted.
        extra: Extra of this package that installs it, as in pyproject.toml.
        to: Purpose, completing "is needed to": "play in the browser".

    Raises:
        BadInput: It is not installed or fails to load; the message says which, and how to install it.
    """
    library = module.partition(".")[0]
    if not is_installed(library):
        raise BadInput(f"{library} is needed to {to} and is not installed: {pip_command(extra)}")
    try:
        return import_module(module)
    except ImportError as error:
        reason = str(error).strip().split("\n")[0]
        raise BadInput(
            f"{library} is needed to {to} and is installed, but fails to load ({reason}): "
            f"{pip_command(extra)} --force-reinstall, or see `deepfracture doctor`"
        ) from error
