"""
Conversion of plans to messages.

rclpy does not check the types of message fields, and sends a wrong type as a wrong value. Numbers
are therefore converted with float() or int() here.
"""

import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from itertools import pairwise
import math
from pathlib import Path as FilePath
import sys
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point, Pose, PoseStamped, Quaternion, Transform, Twist, Vector3)
from nav_msgs.msg import Odometry, Path
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import TimeReference
from std_msgs.msg import ColorRGBA, Float64, Float64MultiArray, MultiArrayDimension, String
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from ..errors import brief, OptionError, ParameterError
from ..mission.participants import NoFlyZone
from ..mission.polygons import convex_parts, offset_polygon, Vertices
from ..mission.scenario import Array, Scenario
from ..output.autopilots import (
    ReferenceSource, rotation, Setpoint, Stack, TRIED_VERSIONS, Vector)
from ..output.drawing import (
    EAVESDROPPER, GEOFENCE, label_position, list_tracks, MARGIN, NO_FLY_ZONE, node_color,
    node_labels, uav_color)
from ..plan.file import make_text
from ..plan.plan import Plan
from ..plan.playback import Moment

_MOST_POINTS = 1000  # Largest number of points of a path marker, which is for display only.


def stamp_at(plan: Plan, seconds: float = 0.0) -> Stamp:
    """Return the time of a plan in s from point 0 as a builtin_interfaces/Time."""
    # A plan from a file may have no start, and then begins at 0.
    whole, rest = divmod(max(0, (plan.start_ns or 0) + round(seconds * 1e9)), 10**9)
    return Stamp(sec=whole, nanosec=rest)


def nanoseconds(stamp: Stamp) -> int:
    """Return the ns of a builtin_interfaces/Time."""
    return stamp.sec * 10**9 + stamp.nanosec


def plan_time(plan: Plan, seconds: float, stamp: Stamp, follower: str = '') -> TimeReference:
    """
    Return the message by which a follower reports the time of its plan.

    :param seconds: time of the plan [s] from point 0.
    :param stamp: time of the clock when the plan was at `seconds`.
    :param follower: name of the follower. `source` is the identity of the plan and this name.
    """
    return _stamped(TimeReference(source=f'{plan.identity} {follower}'.strip(),
                                  time_ref=stamp_at(plan, seconds)), '', stamp)


def read_plan_time(message: TimeReference) -> tuple[str, str]:
    """
    Return the identity of the plan, and the name of the follower, in a report of plan_time.

    Of a longer word than any identity, which comes from a broken sender, 60 characters are left.
    """
    identity, _, follower = message.source.partition(' ')
    return brief(identity, 60), follower


def pose(x: float, y: float, z: float, yaw: float) -> Pose:
    """Return a Pose from metres and radians, counter-clockwise from x (REP-103)."""
    message = Pose()
    _set_pose(message.position, message.orientation, x, y, z, yaw)
    return message


def pose_stamped(frame_id: str, stamp: Stamp, x: float, y: float, z: float, yaw: float
                 ) -> PoseStamped:
    """Return a PoseStamped; see pose."""
    message = PoseStamped()
    _set_pose(message.pose.position, message.pose.orientation, x, y, z, yaw)
    return _stamped(message, frame_id, stamp)


def _set_pose(position: Any, orientation: Quaternion, x: float, y: float, z: float, yaw: float
              ) -> None:
    """Set parts of a message in place; to make new ones takes twice as long."""
    position.x, position.y, position.z = float(x), float(y), float(z)
    orientation.z, orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)


def _stamped(message: Any, frame_id: str, stamp: Stamp) -> Any:
    message.header.frame_id, message.header.stamp = frame_id, stamp
    return message


def path(plan: Plan, uav: int, frame_id: str) -> Path:
    """Return the nav_msgs/Path of the UAV with index `uav`: a pose, with its time, per point."""
    altitude, headings = plan.scenario.uavs[uav].altitude, plan.curve.at(plan.times).headings
    poses = [pose_stamped(frame_id, stamp_at(plan, time), x, y, altitude, yaw)
             for time, (x, y), yaw in zip(plan.times.tolist(), plan.positions[uav].tolist(),
                                          headings[uav].tolist(), strict=True)]
    return _stamped(Path(poses=poses), frame_id, stamp_at(plan))


def power(plan: Plan, uav: int) -> Float64MultiArray:
    """Return the power of a UAV in every slot in W."""
    return _multi_array(plan.powers[uav], ('slot', plan.scenario.slots))


def schedule(plan: Plan) -> Float64MultiArray:
    """Return the share of every slot for each ground node."""
    nodes, slots = plan.shares.shape
    return _multi_array(plan.shares, ('ground_node', nodes), ('slot', slots))


def _multi_array(values: Array, *dimensions: tuple[str, int]) -> Float64MultiArray:
    """Return a message of values, with the label and the size of each dimension."""
    message = Float64MultiArray(data=array.array('d', values.tobytes()))
    message.layout.dim = [MultiArrayDimension(
        label=label, size=size, stride=math.prod(values.shape[index:]))
        for index, (label, size) in enumerate(dimensions)]
    return message


def plan_text(plan: Plan, frame_id: str) -> String:
    """Return a whole plan and its frame, which parse_text of plan/file.py reads."""
    return String(data=make_text(plan, frame_id))


def trajectory(plan: Plan, uav: int, frame_id: str) -> MultiDOFJointTrajectory:
    """Return the flown curve of UAV `uav`, an index, at the points' times, as one joint."""
    member, motion = plan.scenario.uavs[uav], plan.curve.at(plan.times)
    points = [_trajectory_point((x, y, member.altitude), yaw, velocity, acceleration, time)
              for (x, y), yaw, velocity, acceleration, time in zip(
                  motion.positions[uav].tolist(), motion.headings[uav].tolist(),
                  motion.velocities[uav].tolist(), motion.accelerations[uav].tolist(),
                  plan.times.tolist(), strict=True)]
    return _stamped(MultiDOFJointTrajectory(joint_names=[member.name], points=points), frame_id,
                    stamp_at(plan))


def trajectory_setpoint(name: str, frame_id: str, stamp: Stamp, motion: Sequence[Any]
                        ) -> MultiDOFJointTrajectory:
    """
    Return the setpoint of the UAV `name` as a trajectory of one point.

    :param motion: position (x, y, z) in m, yaw in rad, velocity (x, y) in m/s and acceleration
        (x, y) in m/s^2.
    """
    return _stamped(MultiDOFJointTrajectory(
        joint_names=[name], points=[_trajectory_point(*motion)]), frame_id, stamp)


def _trajectory_point(place: Vector, yaw: float, velocity: Sequence[float],
                      acceleration: Sequence[float], seconds: float = 0.0
                      ) -> MultiDOFJointTrajectoryPoint:
    """Return a point of one joint, `seconds` after the first; see trajectory_setpoint."""
    point, transform = MultiDOFJointTrajectoryPoint(), Transform()
    _set_pose(transform.translation, transform.rotation, *place, yaw)
    point.transforms = [transform]
    point.velocities, point.accelerations = [_twist(velocity)], [_twist(acceleration)]
    point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(seconds * 1e9), 10**9)
    return point


def _twist(vector: Sequence[float]) -> Twist:
    twist = Twist()
    twist.linear.x, twist.linear.y = float(vector[0]), float(vector[1])
    return twist


def odometry(frame_id: str, child_frame_id: str, stamp: Stamp, place: Vector,
             yaw: float, velocity: Sequence[float]) -> Odometry:
    """Return Odometry; `velocity` (x, y) [m/s] in frame_id is turned by -yaw into the body's."""
    message = Odometry(child_frame_id=child_frame_id)
    message.pose.pose = pose(*place, yaw)
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    message.twist.twist.linear = Vector3(
        x=float(ahead @ velocity), y=float(ahead[0] * velocity[1] - ahead[1] * velocity[0]))
    return _stamped(message, frame_id, stamp)


def read_setpoint(message: MultiDOFJointTrajectory) -> Setpoint:
    """
    Return the Setpoint in a message. A yaw rate of zero is read as no yaw rate.

    :raises OptionError: unless there is one point, with a transform, or for a wrong value.
    :raises PoseError: if the rotation is not a quaternion of length 1.
    """
    if len(message.points) != 1 or not message.points[0].transforms:
        raise OptionError(f'it has {len(message.points)} points; it must have one, with a '
                          'transform')
    point = message.points[0]
    place, turn = point.transforms[0].translation, point.transforms[0].rotation
    velocity, acceleration = (
        (twists[0].linear.x, twists[0].linear.y, twists[0].linear.z) if twists else None
        for twists in (point.velocities, point.accelerations))
    east, north, _ = rotation((turn.x, turn.y, turn.z, turn.w), 'rotation').apply((1.0, 0.0, 0.0))
    return Setpoint(
        message.header.frame_id, nanoseconds(message.header.stamp), (place.x, place.y, place.z),
        math.atan2(north, east), velocity, acceleration,
        (point.velocities[0].angular.z or None) if point.velocities else None)


def message_class(kind: str) -> Any:
    """Return the class of a message by its name, such as 'nav_msgs/Path'."""
    package, name = kind.split('/')
    return getattr(import_module(f'{package}.msg'), name)


def import_messages(parameter: str, value: str, source: Stack | ReferenceSource,
                    kinds: Iterable[str]) -> list[Any]:
    """
    Return the classes of the messages with names `kinds`, in this order.

    :param source: stack or reference, which says how to get the messages' package.
    :raises ParameterError: if the package is missing; `parameter` = `value` needs the package.
    """
    try:
        return [message_class(kind) for kind in kinds]
    except (ImportError, AttributeError) as error:
        way = (f'apt install {source.debian}' if source.debian else
               f'build {source.source} in your workspace with colcon, and source that')
        if FilePath(rclpy.__file__).is_relative_to(sys.prefix):
            way = f'ROS from wheels cannot have it; run the node with ROS from apt: {way}'
        raise ParameterError(f'parameter {parameter} is {value}: its message package '
                             f'{source.package} is missing ({brief(error, 100)}); {way}') from None


def check_versions(node: Node, kinds: Iterable[str]) -> None:
    """Log a warning for each named message whose MESSAGE_VERSION is not in TRIED_VERSIONS."""
    for kind in kinds:
        version = getattr(message_class(kind), 'MESSAGE_VERSION', None)
        tried = TRIED_VERSIONS.get(kind)
        if version is not None and tried is not None and version not in tried:
            node.get_logger().warning(
                f'{kind} has version {version} and was tried with {" and ".join(map(str, tried))}'
                f': other fields, and topics that end with _v{version}, are possible; build the '
                'px4_msgs of your PX4, or try it in simulation first')


def fill_message(message: Any, values: Mapping[str, Any]) -> Any:
    """Set fields of a message by name and return it; a mapping is a message, a list an array."""
    for field, value in values.items():
        if isinstance(value, Mapping):
            fill_message(getattr(message, field), value)
        elif isinstance(value, list):
            kind = message.get_fields_and_field_types()[field]
            kind = message_class(kind.removeprefix('sequence<').removesuffix('>'))
            setattr(message, field, [fill_message(kind(), fields) for fields in value])
        else:
            setattr(message, field, value)
    return message


def diagnostic_status(name: str, level: bytes, summary: str, values: Mapping[str, Any]
                      ) -> DiagnosticStatus:
    """Return a DiagnosticStatus with values by key: floats with six digits, NaN as `none`."""
    def text(value: Any) -> str:
        if not isinstance(value, float):
            return str(value)
        return 'none' if math.isnan(value) else f'{value:.6g}'

    return DiagnosticStatus(
        level=level, name=name, message=summary, hardware_id='secure_uav_planner',
        values=[KeyValue(key=key, value=text(value)) for key, value in values.items()])


def markers(plan: Plan, frame_id: str, time: float = 0.0) -> MarkerArray:
    """Return paths, receivers at a time [s] from point 0, zones, fence and margin for RViz."""
    scenario = plan.scenario
    grounds, centres, radii = scenario.receivers_at([time])  # (G, 1, 2), (E, 1, 2), (E, 1) in m
    points = np.unique(np.linspace(
        0, scenario.slots + 1, min(scenario.slots + 2, _MOST_POINTS)).astype(int))
    marks = [Marker(action=Marker.DELETEALL)]
    for index, uav in enumerate(scenario.uavs):
        line = [(x, y, uav.altitude) for x, y in plan.positions[index, points].tolist()]
        marks += [_marker('path', index, Marker.LINE_STRIP, uav_color(index), (2.0, 0.0, 0.0),
                          points=line),
                  _label(index, uav.name, (*uav.start, uav.altitude), uav_color(index))]
    size = 0.1 * min(uav.altitude for uav in scenario.uavs)
    for index, (name, place) in enumerate(zip(
            node_labels(scenario), grounds[:, 0].tolist(), strict=True)):
        color = node_color(scenario, index)
        marks += [_marker('ground_node', index, Marker.CYLINDER, color, (size, size, size),
                          (*place, size / 2)),
                  _label(100 + index, name, (*place, 2 * size), color)]
    for index, (name, centre, radius) in enumerate(zip(
            scenario.eavesdropper_names, centres[:, 0].tolist(), radii[:, 0].tolist(),
            strict=True)):
        across = 2 * max(radius, size / 4)
        marks += [_marker('eavesdropper', index, Marker.CYLINDER, EAVESDROPPER,
                          (across, across, 1.0), (*centre, 0.5), opacity=0.5),
                  _label(200 + index, name, (*centre, 2 * size), EAVESDROPPER)]
    marks += [_marker('track', index, Marker.LINE_STRIP, color, (1.0, 0.0, 0.0),
                      points=[(x, y, 0.5) for x, y in track.tolist()])
              for index, (_, track, color) in enumerate(list_tracks(scenario, plan.times[points]))]
    return MarkerArray(markers=[_stamped(marker, frame_id, stamp_at(plan))
                                for marker in (*marks, *_airspace(scenario))])


def plan_messages(plan: Plan, frame_id: str, time: float = 0.0) -> Iterator[tuple[str, Any]]:
    """Yield (topic, message) of each UAV's plan and of the whole plan; see markers for `time`."""
    for index, uav in enumerate(plan.scenario.uavs):
        yield f'{uav.name}/path', path(plan, index, frame_id)
        yield f'{uav.name}/power', power(plan, index)
        yield f'{uav.name}/trajectory', trajectory(plan, index, frame_id)
    yield 'plan', plan_text(plan, frame_id)
    yield '~/schedule', schedule(plan)
    yield '~/markers', markers(plan, frame_id, time)


def serialize_plan(plan: Plan, frame_id: str, time: float = 0.0) -> dict[str, bytes]:
    """Evaluate a plan and return its messages by topic; it takes seconds for 20,000 slots."""
    plan.evaluate()
    return {topic: serialize_message(message)
            for topic, message in plan_messages(plan, frame_id, time)}


def setpoint_messages(scenario: Scenario, moment: Moment, frame_id: str, stamp: Stamp
                      ) -> Iterator[tuple[str, Any]]:
    """Yield (topic, message): each UAV's setpoints and odometry, markers, ground node served."""
    spheres = []
    for index, (uav, (x, y), yaw, velocity, acceleration, watts) in enumerate(zip(
            scenario.uavs, moment.positions, moment.headings, moment.velocities,
            moment.accelerations, moment.powers, strict=True)):
        place = (x, y, uav.altitude)
        yield f'{uav.name}/setpoint/pose', pose_stamped(frame_id, stamp, *place, yaw)
        yield f'{uav.name}/setpoint/power', Float64(data=float(watts))
        yield f'{uav.name}/odom', odometry(
            frame_id, f'{uav.name}/base_link', stamp, place, yaw, velocity)
        yield f'{uav.name}/setpoint/trajectory', trajectory_setpoint(
            uav.name, frame_id, stamp, (place, yaw, velocity, acceleration))
        size = 10.0 + 10.0 * math.sqrt(max(0.0, watts))  # Larger for higher power.
        spheres.append(_stamped(
            _marker('uav', index, Marker.SPHERE, uav_color(index), (size, size, size), place),
            frame_id, stamp))
    yield '~/markers', MarkerArray(markers=spheres)
    transmits = moment.powers[0] > 0 and moment.shares.any()  # UAV 0 serves the ground nodes.
    yield 'setpoint/served', String(
        data=scenario.ground_node_names[moment.shares.argmax()] if transmits else '')


def _airspace(scenario: Scenario) -> list[Marker]:
    """Return markers of zones (prism, edges and name), of the geofence, and of their margins."""
    high, margin = 1.2 * max(uav.altitude for uav in scenario.uavs), scenario.tracking_margin
    marks, margins = [], []
    for index, (zone, name) in enumerate(
            zip(scenario.no_fly_zones, scenario.zone_names, strict=True)):
        floor = zone.floor
        top = min(zone.ceiling, max(high, 1.2 * floor))  # A zone without a ceiling ends there.
        marks += [_marker('no_fly_zone', index, Marker.TRIANGLE_LIST, NO_FLY_ZONE,
                          (1.0, 1.0, 1.0), opacity=0.35, points=_faces(zone, floor, top)),
                  _marker('no_fly_zone_edges', index, Marker.LINE_LIST, NO_FLY_ZONE,
                          (1.5, 0.0, 0.0), points=_edges(zone.vertices, floor, top)),
                  _label(300 + index, name, (*label_position(zone), top), NO_FLY_ZONE)]
        margins += _edges(
            offset_polygon(zone.vertices, margin)[0], max(0.0, floor - margin), top + margin)
    if scenario.geofence is not None and scenario.boundaries.keep_in is not None:
        marks.append(_marker('geofence', 0, Marker.LINE_LIST, GEOFENCE, (1.5, 0.0, 0.0),
                             points=_edges(scenario.geofence, 0.0, high)))
        margins += _edges(scenario.boundaries.keep_in, 0.0, high)
    return marks + ([_marker('tracking_margin', 0, Marker.LINE_LIST, MARGIN, (1.0, 0.0, 0.0),
                             points=margins)] if margin else [])


def _edges(vertices: Vertices, floor: float, top: float) -> list[Vector]:
    """Return the edges of a prism as pairs of points."""
    return [place for (x, y), (to_x, to_y) in pairwise([*vertices, vertices[0]]) for place in (
        (x, y, floor), (to_x, to_y, floor), (x, y, top), (to_x, to_y, top),
        (x, y, floor), (x, y, top))]


def _faces(zone: NoFlyZone, floor: float, top: float) -> list[Vector]:
    """Return the corners (x, y, z) of triangles, three each, of a prism's walls and its top."""
    walls = [place for (x, y), (to_x, to_y) in pairwise([*zone.vertices, zone.vertices[0]])
             for place in ((x, y, floor), (to_x, to_y, floor), (to_x, to_y, top),
                           (x, y, floor), (to_x, to_y, top), (x, y, top))]
    return walls + [(*corner, top) for part in convex_parts(zone.vertices)
                    for pair in pairwise(part[1:]) for corner in (part[0], *pair)]


def _marker(namespace: str, index: int, kind: int, color: str, scale: Vector,
            place: Vector = (0.0, 0.0, 0.0), opacity: float = 1.0, points: Sequence[Vector] = (),
            text: str = '') -> Marker:
    """Return a Marker for RViz; `color` is a text such as '#d62728'."""
    red, green, blue = (int(color[at:at + 2], 16) / 255 for at in (1, 3, 5))
    return Marker(
        ns=namespace, id=index, type=kind, action=Marker.ADD, pose=pose(*place, 0.0), text=text,
        scale=_vector(Vector3, scale), points=[_vector(Point, point) for point in points],
        color=ColorRGBA(r=red, g=green, b=blue, a=float(opacity)))


def _vector(kind: type, numbers: Vector) -> Any:
    x, y, z = map(float, numbers)
    return kind(x=x, y=y, z=z)


def _label(index: int, text: str, place: Vector, color: str) -> Marker:
    return _marker('label', index, Marker.TEXT_VIEW_FACING, color, (0.0, 0.0, 20.0),
                   (*place[:2], place[2] + 20.0), text=text)
