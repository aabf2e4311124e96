"""Base of the nodes that enter the heights of all dwells into one map, published and written as GeoTIFF at the end."""

from __future__ import annotations

import json
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt
from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration

from sal_height import messages
from sal_height.bag.sensor_topics import MAP_ORIGIN
from sal_height.elevation import ESTIMATORS
from sal_height.errors import Rejected, UserError
from sal_height.geometry import UTM, ApertureState, Origin, Projection, find_system, sphere_point
from sal_height.messages.types import HeightImage, Image, NavSatFix, Provenance, ReliefMap
from sal_height.nodes.height_adjuster import PREFIX as ADJUSTED
from sal_height.nodes.parameters import MapFrameParameters, OriginParameters
from sal_height.nodes.placed_points import PlacedPoints
from sal_height.nodes.relief_tracker import PREFIX as TRACKED
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import LATCHED_QOS, ORIGIN, RESET, Stage, StageParameters, payload_bytes
from sal_height.numeric import F64
from sal_height.relief import HeightField, ProjectedAxes, Relief, check_geotiff, write_geotiff
from sal_height.settings import setting

LOCAL = "local"
"""Name for the coordinates of a map that is not placed on the earth."""

LAST_WORDS_S = 2.0
"""Longest wait at the end of the node for subscribers to receive the last map."""


class MapParameters(OriginParameters, MapFrameParameters, StageParameters):
    """Parameters of every node that makes a map."""

    estimator: str = setting(
        "ml",
        "estimator whose heights enter the map; they come on topic <estimator>/height",
        choices=(*ESTIMATORS, TRACKED, ADJUSTED),
        read_only=True,
    )
    max_cells: int = setting(
        4_000_000,
        "greatest number of cells of the map; heights that would need more are left out",
        minimum=1,
        maximum=1_000_000_000,
        read_only=True,
    )
    period_s: float = setting(
        2.0, "shortest time between two maps published", unit="s", minimum=0.1, maximum=3600.0, read_only=True
    )
    file: str = setting(
        "",
        "path of the GeoTIFF that the map is written to when the node ends; an existing file is replaced; empty: none",
        read_only=True,
        names_file=True,
    )
    crs: str = setting(
        UTM,
        "coordinate reference system of the map where its origin is known: utm is the zone of the origin, others are "
        f"named as PROJ does, such as EPSG:25832 or EPSG:32632+5773; {LOCAL} is arc distances from the origin",
        read_only=True,
    )


def map_topics(prefix: str) -> Topics:
    """What a node that makes a map publishes."""
    return {
        f"{prefix}/relief": "map of heights and of their standard deviations, latched",
        f"{prefix}/image": "picture of the map, latched",
        f"{prefix}/points": "the map as points, latched, made while somebody listens",
        f"{prefix}/frame": "the frame that the points are in, near them, latched",
    }


class GrowingMap(Protocol):
    """A map that grows with what is seen."""

    def relief(self) -> Relief | None:
        """Return the map as it stands; None if nothing was seen yet."""


class MapStage(Stage):
    """Enters height images into one map, publishes it, and writes it when the node or its context ends.

    Map and image reach those who come late; points are made only while somebody listens. Where the origin of the map
    frame is known, by parameters or by topic map_origin, the map is one in a projection (parameter crs).
    """

    inputs: ClassVar[Topics] = {"<estimator>/height": "heights of the estimator that the parameter names", **ORIGIN}
    takes_heights = True
    settable = True
    answers: ClassVar[Topics] = {**RESET, "~/save": "write the map as it stands to its file"}
    completes_file = True
    layer: ClassVar[str]
    """Name of the layer of the map, a constant of ReliefLayer."""
    niceness = 10  # a map is as good a second later

    def __init__(self, name: str, prefix: str, **node_arguments: Any) -> None:
        """Make the node `name`, whose topics begin with `prefix`; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed, or the file could not be written at the end.
        """
        super().__init__(name, **node_arguments)
        self._settings = self.current_parameters()
        self._origin = self._settings.origin
        try:
            if self._settings.file:
                check_geotiff(Path(self._settings.file))
            if self._settings.crs not in {LOCAL, UTM}:
                find_system(self._settings.crs)
            self._axes = self._axes_about(self._origin)
        except UserError:
            super().destroy_node()
            raise
        self.failure = ""
        """Why the file could not be written, as a sentence; empty if there was no failure."""
        self._map: GrowingMap | None = None
        self._map_axes: ProjectedAxes | None = None
        self._images = 0
        self._last: HeightImage | None = None
        self._unpublished = False
        self._ended = False
        self._ending = threading.Lock()  # the context may be shut down in another thread than the executor's
        self._relief = self.offer(ReliefMap, f"{prefix}/relief", LATCHED_QOS)
        self._image = self.offer(Image, f"{prefix}/image", LATCHED_QOS)
        self._points = PlacedPoints(self, prefix, LATCHED_QOS)
        topic = f"{self._settings.estimator}/height"
        self.listen(HeightImage, topic, self._on_height, read=messages.received_height)
        if self._origin is None and self._settings.crs != LOCAL:
            self.listen(NavSatFix, MAP_ORIGIN, self._on_origin, LATCHED_QOS, optional=True)
        self.every(self._settings.period_s, self._publish_when_changed)
        self.serve("~/save", self._save)
        self.context.on_shutdown(self.conclude)

    def entered(self, field: HeightField, aperture: ApertureState) -> GrowingMap:
        """Enter a height image seen from `aperture` into the map, or into an empty one, and return that.

        Raises:
            Rejected: the map cannot take it, and has not changed.
        """
        raise NotImplementedError

    def settle(self) -> None:
        """Make the map final; all height images have been entered."""

    def conclude(self) -> None:
        """Enter the height images that wait, publish the map and write the file. May be called twice."""
        with self._ending:
            if self._ended:
                return
            self._ended = True
            self.finish()
            self.settle()
            self._publish()
            with suppress(RCLError):
                self._relief.publisher.wait_for_all_acked(Duration(seconds=LAST_WORDS_S))
            if self._settings.file:
                self._write(Path(self._settings.file))

    def destroy_node(self) -> None:
        """Publish and write the map, then end the node."""
        self.conclude()
        super().destroy_node()

    def _axes_about(self, origin: Origin | None) -> ProjectedAxes | None:
        """The axes of a map whose frame has that origin; None: it is local.

        Raises:
            UserError: the system that parameter crs names does not suit the place.
        """
        if origin is None or self._settings.crs == LOCAL:
            return None
        return ProjectedAxes.around(Projection.of(self._settings.crs, origin))

    def _on_origin(self, message: NavSatFix) -> None:
        """Place the next map that begins."""
        origin = messages.read_origin(message, self._settings.map_frame)
        if origin == self._origin:
            return
        try:
            axes = self._axes_about(origin)
        except UserError as error:
            self.ignore("origin", error)
            return
        if self._map is not None:
            self.ignore(
                "origin after the begin",
                UserError(
                    "The origin of the map frame came, or changed, after the map had begun, which stays where it is "
                    "until service ~/reset begins a new one; publish the origin latched and before the first dwell, or "
                    "set origin_latitude_deg and origin_longitude_deg."
                ),
            )
        self._origin, self._axes = origin, axes

    def _on_height(self, image: HeightImage) -> None:
        if not self.takes():
            return
        if self._ended:
            self.reject(1, Rejected("ended", "The map is written; heights that come later are left out."))
        else:
            self.submit(1, lambda: self._enter(image), payload_bytes(image))

    def forget_results(self) -> int:
        """Begin an empty map."""
        self._map, self._last, self._images, self._unpublished = None, None, 0, False
        return 0

    def _save(self) -> tuple[bool, str]:
        """Write the map as it stands, once the images that wait have been entered."""
        if not self._settings.file:
            return False, "parameter file is empty; it must be the path of a GeoTIFF"
        if self._ended:
            return False, "the node is ending, and writes the map then"

        def write() -> str:
            self.failure = ""
            return "" if self._write(Path(self._settings.file)) else self.failure or "no height was seen"

        failure = self.wait_for(write)
        return not failure, failure or self._settings.file

    def _enter(self, image: HeightImage) -> int:
        """Enter a height image into the map; a rejected image leaves the map unchanged."""
        field = messages.field_from_message(image, self._settings.map_frame)
        if bad := messages.bad_pixels(image, field):
            self.ignore("bad pixels", messages.bad_pixel_warning(image, bad))
        aperture = messages.aperture_from_message(image.aperture)
        axes = self._axes if self._map is None else self._map_axes
        if axes:
            field, aperture = axes.field(field, aperture)
        grown = self.entered(field, aperture)
        self._map, self._map_axes, self._last = grown, axes, image
        self._images += 1
        self._unpublished = True
        return 0

    def _publish_when_changed(self) -> None:
        if self._unpublished and self.jobs <= self.current_parameters().max_queued_dwells:
            self._unpublished = False
            self.submit(0, self._publish)

    def _publish(self) -> int:
        """Publish the current map; returns the number of maps published."""
        relief, last = self._placed_relief(), self._last
        if relief is None or last is None:
            return 0
        crs = self._map_axes.projection.name if self._map_axes else ""
        message = messages.relief_to_message(relief, self.layer, self._images, last, self._provenance(last), crs)
        with suppress(RCLError):  # the context may have ended: nobody is left to publish to
            self._image.publish(messages.relief_picture(relief, last))
            self._points.publish(  # a second for millions
                lambda name: messages.relief_frame(relief, self._place, last, name),
                lambda frame: messages.relief_points(relief, self._place, frame),
            )
            self._relief.publish(message)
        return 1

    def _placed_relief(self) -> Relief | None:
        """The map as it stands, in the coordinates of its projection if it has one; None: nothing was seen yet."""
        relief = self._map.relief() if self._map else None
        return self._map_axes.relief(relief) if relief and self._map_axes else relief

    def _place(self, east: npt.ArrayLike, north: npt.ArrayLike, height: npt.ArrayLike) -> F64:
        """Positions (m) in the map frame of coordinates (m) of the map, shape (..., 3)."""
        if self._map_axes is None:
            return sphere_point(east, north, height)
        return self._map_axes.projection.positions(np.stack(np.broadcast_arrays(east, north, height), axis=-1))

    def _provenance(self, last: HeightImage) -> Provenance:
        """Provenance of the last height image, with the parameters of this node added."""
        return messages.derived(last.provenance, self.get_name(), self._settings)

    def _write(self, path: Path) -> bool:
        """Write the map to a file; whether there was one to write, and it could be."""
        relief = self._placed_relief()
        if relief is None or self._last is None:
            self.get_logger().warning(f"No height was seen: there is no map to write to {path}.")
            return False
        provenance = self._provenance(self._last)
        tags = {
            "estimator": self._last.estimator,
            "images": str(self._images),
            **{key: getattr(provenance, key) for key in ("code_version", "config_hash", "calibration_id")},
            "parameters": json.dumps(messages.stages_of(provenance.parameters), sort_keys=True),
        }
        projection = self._map_axes.projection if self._map_axes else None
        stamp_ns = messages.to_ns(self._last.header.stamp)
        try:
            write_geotiff(path, relief, projection, stamp_ns, tags)
        except UserError as error:
            self.failure = str(error)
            self.get_logger().error(self.failure)
            return False
        if projection is None and self._settings.crs != LOCAL:
            self.get_logger().warning(
                f"{path} has local coordinates; set origin_latitude_deg and origin_longitude_deg, or publish topic "
                f"{MAP_ORIGIN}, to place it on the earth."
            )
        return True
