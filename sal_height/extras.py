"""Packages that only some commands need, which are extras of the installation."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from sal_height.errors import UserError


def import_extra(module: str, doing: str, extra: str = "formats") -> Any:
    """Return a module of a package that is an extra.

    Args:
        module: name of the module, such as "sarkit.sicd".
        doing: purpose of the module, as the start of a message, such as "Reading a.nitf".
        extra: name of the extra.

    Raises:
        UserError: the package is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise UserError(f"{doing} needs {package}; install it with: pip install 'sal_height[{extra}]'.") from error
