"""Custom data of a copy of a bag."""

from __future__ import annotations

import json

import yaml

from sal_height.bag.files import PARAMETERS, parameters_file
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import Packing


def kept_custom_data(reader: BagReader) -> dict[str, str]:
    """The custom data of a bag, with the parameters of an older one, which are in a file of their own next to it."""
    file = parameters_file(reader.path)
    if PARAMETERS in reader.custom_data or not file.is_file():
        return dict(reader.custom_data)
    try:
        values = json.dumps(yaml.safe_load(file.read_text(encoding="utf-8")) or {})
    except (OSError, ValueError, TypeError, yaml.YAMLError):  # a replay of the original refuses it
        return dict(reader.custom_data)
    return {**reader.custom_data, PARAMETERS: values}


def kept_packing(reader: BagReader) -> Packing:
    """One file, compressed as the first chunk of the bag is."""
    chunks = (chunk for index in reader.indexes for chunk in index.summary.chunk_indexes)
    first = next(chunks, None)
    return Packing((first.compression if first else "") or "none")
