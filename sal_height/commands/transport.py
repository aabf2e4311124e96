"""`sal-height transport`: settings of Fast DDS for programs that publish phase histories."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import DONE, PROCESSING, command

EXAMPLES = """
  sal-height transport > fastdds.xml
  export FASTRTPS_DEFAULT_PROFILES_FILE=$PWD/fastdds.xml
  sal-height transport --dwell-mb 134 > fastdds.xml
  sal-height transport --packet-bytes 1400 > fastdds.xml
"""

app = command("transport", PROCESSING, EXAMPLES)


@app.default
def transport(
    *,
    dwell_mb: Annotated[float, Parameter(metavar="MB", validator=Number(gte=0, lte=16_000))] = 8.0,
    packet_bytes: Annotated[int | None, Parameter(metavar="BYTES", validator=Number(gte=576, lte=65_500))] = None,
) -> int:
    """Print settings of Fast DDS for a program that publishes phase histories.

    Fast DDS allocates half a megabyte of shared memory for a process, less than a
    dwell needs: frames are lost or late, and odometry with them. The nodes allocate
    more by themselves. A publisher of your own, in any language, does so if it is
    started with the variable of the second example.

    On a network that loses packets, as radio links do, use --packet-bytes 1400,
    also for nodes: lost packets are then sent again one by one. By default 8 kB
    travel together, up to 64 kB of large dwells, and are lost together.

    Args:
        dwell_mb: Size of the samples of a dwell, in megabytes.
        packet_bytes: Size of the packets of messages, in bytes.
    """
    from sal_height.nodes.transport.middleware import settings_for

    print(settings_for(int(dwell_mb * 1e6), packet_bytes=packet_bytes or 0), end="")
    return DONE
