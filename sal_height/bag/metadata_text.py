"""YAML that programs write and read: by libyaml where PyYAML has it, which needs a tenth of the time."""

from __future__ import annotations

from typing import Any

import yaml

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def read_yaml(text: str) -> Any:
    """Plain data of a text.

    Raises:
        yaml.YAMLError: it is not YAML.
    """
    return yaml.load(text, _LOADER)  # noqa: S506 (a safe one)


def yaml_text(content: object, *, sort_keys: bool = True) -> str:
    """Plain data as a text."""
    return str(yaml.dump(content, Dumper=_DUMPER, sort_keys=sort_keys))
