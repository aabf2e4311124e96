"""The chunks of a file whose index is lost, found past damage by the lengths in them that must agree."""

from __future__ import annotations

import mmap
import re
import struct
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

HEAD = struct.Struct("<BQ")
"""Opcode and length of a record."""

OPCODES = frozenset(Opcode)

COMPRESSION = HEAD.size + 28
"""Position of the name of the compression in a chunk: after times, size and checksum."""

CHUNK_FIELDS = 40
"""Bytes before the data of a chunk that is not compressed, after opcode and length."""

LENGTH = struct.Struct("<Q")

CHUNK = re.compile(rb"(?=%c.{%d}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd))" % (Opcode.CHUNK, COMPRESSION - 1), re.DOTALL)
"""Start of a chunk, at every position."""


def is_known(opcode: int) -> bool:
    """True if there are records with this opcode."""
    return opcode in OPCODES or opcode >= 0x80  # of private records, which may be anywhere


def find_chunks(stream: BinaryIO) -> dict[int, int]:
    """Offsets of the chunks of a file, and their bytes.

    Records follow from each other by their lengths. Where one does not lead to another, or is a chunk whose lengths
    contradict each other, the next chunk whose lengths agree is searched.
    """
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return _find_chunks(data)


def _find_chunks(data: mmap.mmap) -> dict[int, int]:
    chunks, place = {}, len(MCAP0_MAGIC)
    while place < len(data):
        following = _following(data, place)
        leads_on = following == len(data) or _following(data, following) > 0
        is_chunk = data[place] == Opcode.CHUNK
        if (is_chunk and _is_sound_chunk(data, place)) or (is_chunk and following and leads_on):
            chunks[place] = following - place
        elif not (following and leads_on):
            following = min(following or len(data), _next_chunk(data, place + 1))
        place = following
    return chunks


def _following(data: mmap.mmap, place: int) -> int:
    """End of a record that may start at a position; 0: no record that ends in the file."""
    if not 0 < place <= len(data) - HEAD.size:
        return 0
    opcode, length = HEAD.unpack_from(data, place)
    end = place + HEAD.size + length
    return end if is_known(opcode) and end <= len(data) else 0


def _is_sound_chunk(data: mmap.mmap, place: int) -> bool:
    """True if a whole chunk starts at a position: its length and those of its parts agree."""
    end = _following(data, place)
    if not end or end - place < COMPRESSION + 4 + LENGTH.size:
        return False
    (name,) = struct.unpack_from("<I", data, place + COMPRESSION)
    records = place + COMPRESSION + 4 + name + LENGTH.size
    return records <= end and records + LENGTH.unpack_from(data, records - LENGTH.size)[0] == end


def _next_chunk(data: mmap.mmap, place: int) -> int:
    """Start of the next sound chunk; the end of the file if there are no more."""
    found = (match.start() for match in CHUNK.finditer(data, place))
    return next((start for start in found if _is_sound_chunk(data, start)), len(data))
