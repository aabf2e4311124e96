"""Write `sal_height/kernel_types.txt`: the kernels that a first demo needs, and the types of their arguments.

`python -m tools.kernel_types`, after a change of a kernel or of its arguments. It runs a few dwells of each preset.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from numba import types

from sal_height.commands import main as sal_height
from sal_height.numeric.jit import LOOPS
from sal_height.precompile import LIST

RUNS = (("sal_spotlight", 2), ("sal_stripmap", 4), ("xband_relief", 2), ("small", 2))
"""Presets of `make demo` and of the first tutorial, and numbers of dwells."""

HEAD = "# Kernels that runs of the presets compile, and the types of their arguments: python -m tools.kernel_types\n"


def main() -> None:
    """Run the presets, and write what they have called."""
    for preset, dwells in RUNS:
        with tempfile.TemporaryDirectory() as folder:
            sal_height(["run", "--preset", preset, "--dwells", str(dwells), "--out", str(Path(folder) / preset)])
    LIST.write_text(HEAD + "".join(f"{line}\n" for line in sorted(called())), encoding="utf-8")


def called() -> list[str]:
    """All calls of loops in this process: name of the loop and types of its arguments."""
    return [
        f"{name} ({', '.join(map(text_of, arguments))},)"
        for name, loop in LOOPS.items()
        for arguments in loop.overloads
    ]


def text_of(kind: types.Type) -> str:
    """A numba type as an expression that `sal_height.precompile` evaluates."""
    if isinstance(kind, types.Array):
        flags = f"{'' if kind.mutable else ', readonly=True'}{'' if kind.aligned else ', aligned=False'}"
        return f"Array({text_of(kind.dtype)}, {kind.ndim}, {kind.layout!r}{flags})"
    if isinstance(kind, types.BaseTuple):
        of_class = getattr(kind, "instance_class", None)
        named = f", {f'{of_class.__module__}.{of_class.__name__}'!r}" if of_class else ""
        return f"tuple_of([{', '.join(map(text_of, kind))}]{named})"
    if isinstance(kind, types.Literal):
        return f"literal({kind.literal_value!r})"
    if isinstance(kind, types.Omitted):
        return f"Omitted({kind.value!r})"
    return "slice2_type" if kind == types.slice2_type else str(kind)


if __name__ == "__main__":
    main()
