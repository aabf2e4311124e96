from typing import Any

def __getattr__(name: str) -> Any: ...  # the classes are made when they are first asked for, and have no types
