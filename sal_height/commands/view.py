"""`sal-height view`: show a bag or the live graph in the Rerun viewer."""

from __future__ import annotations

import math
import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import BAGS, DONE, FAILED, Flag, command, complain, importing
from sal_height.io import bag_name

EXAMPLES = """
  sal-height view out/sal_spotlight/bag
  sal-height view out/sal_spotlight/bag --save flight.rrd
  sal-height view out/sal_spotlight/bag --web --port 9090
  sal-height view --domain 7             during: sal-height live --domain 7
  sal-height view --namespace uav1 --web
"""

app = command("view", BAGS, EXAMPLES, "no message could be shown")


@app.default
def view(
    bag: Annotated[Path | None, Parameter(name="BAG", help="Folder of the bag, or its .mcap file.")] = None,
    /,
    *,
    save: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    web: Flag = False,
    port: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=1024, lte=65534))] = None,
    domain: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=0, lte=232))] = None,
    namespace: Annotated[str, Parameter(metavar="NAME")] = "",
    map_frame: Annotated[str, Parameter(metavar="NAME")] = "map",
    seconds: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0))] = None,
    history: Annotated[float, Parameter(metavar="S", validator=Number(gt=0))] = 10.0,
    memory_mb: Annotated[int, Parameter(metavar="MB", validator=Number(gte=100))] = 2000,
) -> int:
    """Show heights, images, tracks and the state of the nodes in the Rerun viewer.

    With a bag, its contents are shown, and the command ends; the window stays.
    Without one, the topics of the live graph are shown as they arrive, until Ctrl-C
    or the window is closed. Messages for which the viewer is too slow are left out
    and counted; the graph never waits for it.

    It needs the Python package rerun-sdk.

    Args:
        save: Write this file of the Rerun viewer, which must not exist, instead of opening a window.
        web: Serve the viewer to browsers on this machine, until Ctrl-C, instead of opening a window.
        port: Port of the page, with --web; data are at the next one. Default: free ones.
        domain: ROS domain of the live graph, on this machine. Default: that of the environment variables of ROS.
        namespace: Show sensors in this namespace only.
        map_frame: Name of the frame that positions are in, as the parameter of that name of the nodes says.
        seconds: End the live view after this time.
        history: Seconds of points that are seen at once of a live graph; of a bag, all up to the time shown are.
        memory_mb: Memory of the viewer, in megabytes; it forgets what is oldest.
    """
    from sal_height.errors import UserError

    if save is not None and web:
        raise UserError("Options --save and --web exclude each other; give one of them.")
    if port is not None and not web:
        raise UserError("Option --port is of the page that --web serves; give --web, too.")
    with importing():
        from sal_height.bag.reader import BagReader
        from sal_height.view.screen import file_screen, page_screen, window_screen
        from sal_height.view.show import Recorded, show_bag, show_live, wait_for_interrupt

    if bag is None:
        from sal_height.view.listener import Listener

        os.nice(10)  # the viewer, too, yields to the nodes
    recorded = None if bag is None else Recorded(BagReader(bag), namespace)
    how = ("live graph", history) if bag is None else (bag_name(bag), math.inf)
    with ExitStack() as stack:
        if save is not None:
            screen = stack.enter_context(file_screen(save, *how))
        elif web:
            screen = stack.enter_context(page_screen(port, memory_mb, *how))
            print(f"open {screen.page} in a browser; Ctrl-C ends it", flush=True)
        else:
            screen = stack.enter_context(window_screen(memory_mb, *how))
        if recorded is None:
            from sal_height.nodes.transport.domain import ros_domain

            stack.enter_context(ros_domain("environment" if domain is None else domain))
            queue_bytes = 64_000_000  # memory of messages that wait to be shown
            listener = stack.enter_context(Listener(namespace, queue_bytes))
            end = time.monotonic() + (math.inf if seconds is None else seconds)

            def is_over() -> bool:
                return time.monotonic() >= end or not screen.is_open()

            shown = show_live(listener, screen, is_over, map_frame)
        else:
            shown = show_bag(recorded, screen, map_frame)
            screen.hand_over()
        count = sum(shown.drawn.values())
        topics = ", ".join(sorted(shown.drawn)) or "no topic"
        print(f"{count} {'message' if count == 1 else 'messages'} shown on {topics}", flush=True)
        complain(shown.complaints())
        if web and recorded:
            wait_for_interrupt(screen)
    if save is not None:
        print(f"see {save}, with: rerun {save}")
    return DONE if count else FAILED
