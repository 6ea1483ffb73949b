"""Origin of the local frame of each vehicle: by parameter, or as its autopilot reports it."""

from collections.abc import Callable, Mapping
from functools import partial
import math
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from .messages import check_versions, import_messages
from .settings import FrameSettings
from .topics import LATCHED, overridable, SENSOR
from ..errors import brief, OptionError, PlanningError, PoseError
from ..mission.geography import Origin
from ..output.autopilots import Reference, REFERENCES, Vector


class LocalFrames:
    """
    Converts positions between the frame of the mission and the local frames of the vehicles.

    The origin of a frame is `<uav>.origin`. With `<uav>.reference` it is a place on Earth, at the
    height of `<uav>.origin`.

    :param current: returns the present settings of the node.
    :param vehicles: the namespace of each vehicle by the name of its UAV.
    :param on_change: called with the name of a UAV when its frame becomes known, unknown or moves.
        If it has moved, or its estimator was reset, the second argument converts a position from
        the old frame to the new one; otherwise it is None.
    :ivar moves: what has happened to the frame of each UAV, in words, until it is cleared.
    :raises ParameterError: if the message package of a reference is missing.
    """

    def __init__(self, node: Node, current: Callable[[], FrameSettings],
                 vehicles: Mapping[str, str],
                 on_change: Callable[[str, Callable[[Vector], Vector] | None], None]) -> None:
        self._current, self._log, self._on_change = current, node.get_logger(), on_change
        self._origin = current().origin  # Origin of the mission's frame on Earth, or None.
        self._references: dict[str, Reference] = {}  # Last message used of each UAV.
        self._frames: dict[str, Origin] = {}  # Origin of each UAV's local frame on Earth.
        self._unknown: dict[str, str] = {}  # Why the frame of a UAV is unknown, by the UAV's name.
        self.moves: dict[str, str] = {}  # What has happened to the frame of a UAV, in words.
        for name, vehicle in vehicles.items():
            self._subscribe(node, name, vehicle, current().uavs[name].reference)

    def _subscribe(self, node: Node, name: str, vehicle: str, reference: str) -> None:
        """Subscribe to the origin of a UAV's local frame, unless `reference` is 'none'."""
        source = REFERENCES.get(reference)
        if source is None:
            return
        topics = [f'{vehicle}/{topic}' for topic in source.topics]
        self._unknown[name] = f'where its frame begins has not come on {" or ".join(topics)}'
        kind, = import_messages(f'{name}.reference', reference, source, [source.kind])
        check_versions(node, [source.kind])
        callback = partial(self._on_message, name, source.read)
        for topic in topics:
            node.create_subscription(kind, topic, callback, **overridable(SENSOR))
            # The latched subscription gets a message from before this node's start. That it does
            # not match a publisher that is not latched is no reason for a warning.
            node.create_subscription(kind, topic, callback, LATCHED, event_callbacks=(
                SubscriptionEventCallbacks(use_default_callbacks=False)))

    def to_local(self, name: str, place: Vector) -> Vector:
        """
        Convert a position (x, y, z) [m] from the mission's frame to a UAV's local frame.

        First `<uav>.origin` is subtracted. With `<uav>.reference`, x and y are then converted by
        way of latitude and longitude.

        :raises PoseError: while the origin of the local frame is unknown; as _convert does.
        """
        x, y, z = (value - shift for value, shift in zip(place, self._shift(name), strict=True))
        frame = self._frame(name)
        return (x, y, z) if frame is None else _convert((x, y, z), self._origin, frame)

    def to_mission(self, name: str, place: Vector) -> Vector:
        """Convert a position (x, y, z) [m] from a UAV's local frame; the inverse of to_local."""
        frame = self._frame(name)
        place = place if frame is None else _convert(place, frame, self._origin)
        x, y, z = (value + shift for value, shift in zip(place, self._shift(name), strict=True))
        return (x, y, z)

    @property
    def problems(self) -> list[str]:
        """Problems of the frames in words."""
        return [*map(self._explain, self._unknown), *self.moves.values()]

    def _shift(self, name: str) -> Vector:
        return self._current().uavs[name].origin

    def _frame(self, name: str) -> Origin | None:
        """Return the origin on Earth of a UAV's frame; None without `<uav>.reference`."""
        if name in self._unknown:
            raise PoseError(self._explain(name))
        return self._frames.get(name)

    def _explain(self, name: str) -> str:
        return f'the local frame of {name} is not known: {self._unknown[name]}'

    def _on_message(self, name: str, read: Callable[[Any], Reference], message: Any) -> None:
        """
        Take the origin of a local frame from a message; log a change and call on_change.

        A message that cannot be read, or is far from the mission, makes the frame unknown.
        """
        try:
            reference = read(message)
            if reference == self._references.get(name) and name not in self._unknown:
                return
            frame = self._locate(reference)
        except PlanningError as error:
            if self._unknown.get(name) != brief(error):
                self._unknown[name] = brief(error)
                self._log.warning(self._explain(name), throttle_duration_sec=1.0)
                self._on_change(name, None)
            return
        before, last = self._frames.get(name), self._references.get(name)
        self._unknown.pop(name, None)
        self._references[name], self._frames[name] = reference, frame
        if before is None:
            self._log.info('the local frame of {} begins at ({:.2f}, {:.2f}) m'.format(
                name, *self.to_mission(name, (0.0, 0.0, 0.0))))
        if before is None or reference == last:
            self._on_change(name, None)
            return
        distance = math.hypot(*_convert((0.0, 0.0, 0.0), frame, before)[:2])
        is_reset = last is not None and reference[:2] == last[:2]
        self.moves[name] = (
            f'the position estimator of {name} has been reset' if is_reset else
            f'the local frame of {name} has moved by {distance:.2f} m')
        self._log.warning(self.moves[name])
        self._on_change(name, lambda place: _convert(place, before, frame))

    def _locate(self, reference: Reference) -> Origin:
        """Return the origin of a frame; raise an error if it is far from the mission."""
        assert self._origin is not None
        self._origin.to_local(reference.latitude, reference.longitude)
        return Origin(reference.latitude, reference.longitude, self._origin.projection)


def _convert(place: Vector, source: Origin | None, target: Origin | None) -> Vector:
    """
    Convert a position from the frame of a source origin to the frame of a target origin.

    :raises PoseError: if the position is too far from an origin for the origin's projection.
    """
    assert source is not None and target is not None
    try:
        x, y = target.to_local(*source.to_geographic(*place[:2]))
    except OptionError as error:
        raise PoseError(str(error)) from None
    return (float(x), float(y), place[2])
