"""Kernels that are compiled before a run: which they are, and that they are those that the run calls."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from numba import types

from sal_height import precompile
from sal_height.elevation.layover._extended_kernels import SurfacePrior
from sal_height.numeric.jit import LOOPS, is_cached, loops_called
from tools.kernel_types import text_of


def test_types_of_arguments_survive_as_text() -> None:
    """All kinds that kernels have."""
    vector = types.Array(types.float64, 1, "C", readonly=True)
    kinds = (
        types.int64,
        vector,
        types.Array(types.complex64, 3, "A"),
        types.UniTuple(vector, 2),
        types.Tuple((vector, types.boolean)),
        types.Omitted(0.5),
        types.literal(3),
        types.slice2_type,
        types.NamedUniTuple(types.float64, 5, SurfacePrior),
    )
    assert precompile._types(f"({', '.join(map(text_of, kinds))},)") == kinds
    assert precompile._types(f"({text_of(vector)},)") == (vector,)


def test_the_list_is_of_kernels_that_exist_and_of_types_that_they_accept() -> None:
    """Kernels have not been renamed, and have as many arguments as when the list was made."""
    listed = precompile._listed()
    assert len(listed) > 50
    for name, calls in listed.items():
        code = precompile._loop(name).py_func.__code__
        assert {len(precompile._types(call)) for call in calls} == {code.co_argcount}, name
    assert any(loops_called(LOOPS[name]) for name in listed)


KERNELS = """
from sal_height.numeric.jit import compiled, inlined
@compiled
def twice(x):
    return x + x
@inlined
def fourfold(x):
    return twice(x) + twice(x)
@compiled
def fivefold(x):
    return fourfold(x) + x
"""

PROGRAM = """
import sys
from pathlib import Path
import kernels
from sal_height import precompile
if __name__ == "__main__":
    precompile.LIST = Path(sys.argv[1])
    print(precompile.precompile(), precompile.precompile(), len(kernels.fivefold.overloads))
    print(kernels.fivefold(2.0), sum(kernels.fivefold.stats.cache_hits.values()))
"""


def test_kernels_are_compiled_once_and_by_other_processes(tmp_path: Path) -> None:
    """This one finds them cached, after those that they call, and says so in plain lines where there is no terminal."""
    (tmp_path / "kernels.py").write_text(KERNELS)
    (tmp_path / "program.py").write_text(PROGRAM)
    types = tmp_path / "types.txt"
    types.write_text("# kernels\nkernels.fivefold (float64,)\nkernels.twice (float64,)\n")
    command = [sys.executable, tmp_path / "program.py", types]
    paths = {**os.environ, "PYTHONPATH": f"{tmp_path}:{Path(precompile.__file__).parents[1]}"}
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env=paths)  # noqa: S603 (our own program)
    assert ran.stdout.splitlines() == ["2 0 0", "10.0 1"], ran.stderr
    assert "2 of 2 kernel" in ran.stderr
    assert "\r" not in ran.stderr


def test_what_is_cached_is_known_without_loading_it() -> None:
    loop = precompile._loop("sal_height.numeric._kernels.cosine_and_sine")
    assert not is_cached(loop, (types.Array(types.float32, 7, "A"),))
