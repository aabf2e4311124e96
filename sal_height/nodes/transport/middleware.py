"""Shared memory of the middleware, large enough for phase histories.

Fast DDS hands messages to other processes by shared memory of half a megabyte, unless configured otherwise. A dwell is
larger: its frames then wait for room or go over the network, and keep platform states waiting for seconds.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from rclpy.logging import get_logger

from sal_height.errors import UserError
from sal_height.nodes.transport.leftovers import SHARED_MEMORY, avoid_dead_ports, remove_orphans

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Environment variable that names the file with settings of Fast DDS; it is read when the first node starts."""

ENOUGH = 64_000_000
"""Shared memory of a process, bytes, unless its dwells are larger. Messages travel in pieces of a 2000th: in those of
32 kB a dwell of 2 MB wakes its receivers a quarter as often as in those of 8 kB, and is 6 % cheaper as a whole."""

LEAST = 4_000_000
"""Shared memory of a process, bytes, below which the default settings of Fast DDS do as well."""

PIECES, LEAST_PIECE = 2000, 8000
"""A message travels in pieces: that many fill the shared memory of a process; least size of one, bytes.

A piece needs one free block. Where enough is free but scattered, Fast DDS gives up the piece and frees nothing: once
messages for a process that was killed have filled the memory, no piece larger than the largest gap is ever sent again.
The reserve, which nothing fills, is a 32nd of the memory: no gap can be too small as long as pieces are far smaller.
"""

SHARE = 1 / 16
"""Fraction of the machine's free shared memory that one process may use: others need theirs."""

TEMPLATE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>shared_memory</transport_id>
        <type>SHM</type>
        <segment_size>{segment}</segment_size>
        <maxMessageSize>{piece}</maxMessageSize>
        <port_queue_capacity>8192</port_queue_capacity>
        <healthy_check_timeout_ms>5000</healthy_check_timeout_ms>
      </transport_descriptor>
      <transport_descriptor>
        <transport_id>network</transport_id>
        <type>UDPv4</type>{network}
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="sal_height" is_default_profile="true">
      <rtps>
        <userTransports>
          <transport_id>shared_memory</transport_id>
          <transport_id>network</transport_id>
        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
        <builtin>
          <discovery_config>
            <leaseDuration>
              <sec>5</sec>
            </leaseDuration>
            <leaseAnnouncement>
              <sec>0</sec>
              <nanosec>250000000</nanosec>
            </leaseAnnouncement>
          </discovery_config>
        </builtin>
      </rtps>
    </participant>
    <data_writer profile_name="sal_height" is_default_profile="true">
      <times>
        <heartbeatPeriod>
          <sec>0</sec>
          <nanosec>200000000</nanosec>
        </heartbeatPeriod>
      </times>
    </data_writer>
  </profiles>
</dds>
"""
"""Participants send by shared memory on this machine, and by UDP to others.

They announce themselves four times a second, every 3 s by default: one that starts later, or again, is found that soon.
One that was killed is assumed to run until nothing has been received of it for 5 s, 20 s by default.
And they ask five times a second, every 3 s by default, what of their messages has not arrived, to send it again.

The ports of one that stands still are assumed dead after 5 s, 1 s by default, when nobody sends to it any more.
A sender makes the port again with each message, and one that goes on meanwhile may never be reached again (`domain`).
Those of a process that was killed are not known to be dead as long: none that starts takes one (`leftovers`).
"""


LOOPBACK = "\n        <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>"
"""Restricts a participant to this machine. By ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST alone it sends its
announcements nowhere else, but answers programs that address it."""


PACKETS = "\n        <maxMessageSize>{}</maxMessageSize>"
"""Has messages travel in packets of that size, by shared memory too. What a network that takes larger ones apart loses
a part of is lost as a whole."""


def segment_bytes(dwell_bytes: int, free_bytes: int) -> int | None:
    """Shared memory that a process uses, bytes.

    Args:
        dwell_bytes: size of the samples of a dwell, bytes; 0: not known.
        free_bytes: size of the machine's free shared memory, bytes.

    Returns:
        A number of bytes, or None if too few are free for it to be of use.
    """
    kept_dwells = 2  # dwells for which the shared memory has room: one is written while another is read
    segment = min(max(ENOUGH, kept_dwells * dwell_bytes), int(SHARE * free_bytes))
    return segment if segment >= LEAST else None


def free_bytes() -> int:
    """Bytes that are free in the shared memory of the machine."""
    return shutil.disk_usage(SHARED_MEMORY).free if SHARED_MEMORY.is_dir() else 0


def settings_for(dwell_bytes: int, *, local: bool = False, packet_bytes: int = 0) -> str:
    """Settings of Fast DDS, as XML, with which a process publishes dwells of that size.

    Args:
        dwell_bytes: size of the samples of a dwell, bytes; 0: not known.
        local: True if other machines can reach nothing of the process.
        packet_bytes: size of the packets in which messages travel, bytes; 0: that of the pieces by shared memory.

    Raises:
        UserError: too little shared memory is free.
    """
    free = free_bytes()
    segment = segment_bytes(dwell_bytes, free)
    if segment is None:
        raise UserError(
            f"{SHARED_MEMORY} has {free / 1e6:.0f} MB free; with less than {LEAST / SHARE / 1e6:.0f} MB frames may "
            "arrive late or get lost between processes. Containers get more by --shm-size."
        )
    network = (LOOPBACK if local else "") + (PACKETS.format(packet_bytes) if packet_bytes else "")
    return TEMPLATE.format(segment=segment, piece=max(LEAST_PIECE, segment // PIECES), network=network)


def provide_shared_memory(dwell_bytes: int = 0) -> None:
    """Have the nodes of this process, and of those that it starts, use shared memory with room for dwells of that size.

    What processes that were killed have left of it is given back first. Where the variables of ROS keep nodes to this
    machine, no other can reach them. This has an effect before the first node of a process only. Whoever uses another
    middleware, or has settings of Fast DDS in a file of their own, keeps them.
    """
    remove_orphans()
    avoid_dead_ports()
    if (
        not os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
        or PROFILES in os.environ
    ):
        return
    try:
        settings = settings_for(dwell_bytes, local=_keeps_to_machine())
    except UserError as error:
        get_logger("sal_height").warning(str(error))
        return
    folder = tempfile.mkdtemp(prefix="sal_height_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    file = Path(folder, "fastdds.xml")
    file.write_text(settings, encoding="utf-8")
    os.environ[PROFILES] = str(file)


def _keeps_to_machine() -> bool:
    """True if the environment variables of ROS let nodes find none of other machines."""
    peers = os.environ.get("ROS_STATIC_PEERS", "")
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") in {"LOCALHOST", "OFF"} and not peers
