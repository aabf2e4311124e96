"""Stamps of serialized messages, read at their position."""

from __future__ import annotations

import struct

STAMP = struct.Struct("<iI")
STAMP_AT = 4
"""Position of the stamp in a serialized message whose first field is a header: after the four bytes that name the
encoding (CDR, OMG DDS-XTypes 1.3, section 7.4.3; little endian in all ROS middlewares in use)."""


def stamp_ns_of(cdr: bytes) -> int:
    """The stamp of a serialized message whose first field is a header, ns."""
    seconds, nanoseconds = STAMP.unpack_from(cdr, STAMP_AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
