"""A package that is an extra is named with the command that installs it."""

from __future__ import annotations

import numpy.linalg
from helpers import refused

from sal_height.errors import UserError
from sal_height.extras import import_extra


def test_a_module_of_a_package_that_is_there_is_returned() -> None:
    assert import_extra("numpy.linalg", "Solving") is numpy.linalg


def test_a_package_that_is_not_there_is_named_with_what_installs_it() -> None:
    with refused(UserError, "Writing a.tif needs no_such_package;", "pip install 'sal_height[dem]'"):
        import_extra("no_such_package.part", "Writing a.tif", "dem")
