"""
Serialized messages of a plan (CDR, little-endian, as DDS carries them) as arrays.

rclpy blocks all threads while it makes objects: 0.3 s for a trajectory of 2,000 points. NumPy
reads the points in place, because they are equally long.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import blake2b
import struct
from typing import NamedTuple

import numpy as np

from ..errors import brief, PlanError
from ..mission.fields import find_range
from ..mission.scenario import Array, MAX_NODES, Scenario

_POSE, _POINT = 56, 184  # Bytes of a pose, and of a point with one of each of its parts.
_MOST = int(find_range(Scenario, 'slots').high) + 2  # Points.


def digest(stamp_ns: int, *arrays: Array) -> str:
    """Return a hash of a path or a trajectory, 8 digits."""
    content = [str(stamp_ns).encode(), *(array.tobytes() for array in arrays)]
    return blake2b(b' '.join(content), digest_size=4).hexdigest()


class PathContent(NamedTuple):
    """
    Content of a nav_msgs/Path.

    :ivar pose_frames: the frame of the first pose, and the first different one.
    :ivar times_ns: of the poses, (P,) in ns; P = 0 if these have different frames.
    :ivar places: of the poses, (P, 3) in m.
    """

    stamp_ns: int
    frame: str
    pose_frames: list[str]
    times_ns: Array
    places: Array

    @property
    def key(self) -> str:
        """Digest of the stamp and the horizontal places."""
        return digest(self.stamp_ns, self.places[:, :2])


class PowerContent(NamedTuple):
    """
    Content of a std_msgs/Float64MultiArray.

    :ivar levels: in W, (N,).
    :ivar key: identity of the plan, empty if the message does not name it.
    :ivar path: digest of the path of that plan.
    :ivar trajectory: likewise.
    :ivar schedule: likewise, empty for a plan with a single ground node.
    """

    levels: Array
    key: str = ''
    path: str = ''
    trajectory: str = ''
    schedule: str = ''


class ScheduleContent(NamedTuple):
    """
    Content of a schedule, a std_msgs/Float64MultiArray.

    :ivar shares: of the slots, (G, N).
    :ivar names: of the ground nodes.
    """

    shares: Array
    names: list[str]

    @property
    def key(self) -> str:
        """Digest of the shares."""
        return digest(0, self.shares)


class TrajectoryContent(NamedTuple):
    """
    Content of a trajectory_msgs/MultiDOFJointTrajectory.

    :ivar size: the number of points.
    :ivar motion: horizontal positions, velocities and accelerations, (size, 2) each, or None
        unless each point has one of each.
    """

    stamp_ns: int
    frame: str
    size: int
    motion: list[Array] | None

    @property
    def key(self) -> str:
        """Digest of the stamp and the motion."""
        return digest(self.stamp_ns, *self.motion or ())


def read_path(data: bytes) -> PathContent:
    """Return the content of a path, or raise a PlanError."""
    with _reading():
        cursor = _Cursor(data)
        stamp, frame, count = cursor.stamp(), cursor.string(), cursor.count()
        nothing = np.empty(0, int), np.empty((0, 3))
        if not count:
            return PathContent(stamp, frame, [], *nothing)
        begin, first, pose_frame = cursor.at, cursor.stamp(), cursor.string()
        name = data[begin + 12:cursor.at]
        places_at = cursor.align(8)
        stride = -(-(12 + len(name)) // 8) * 8 + _POSE
        # Poses in different frames may be shorter, and the last of them end after the message.
        later = min(count - 1, -(-(len(data) - places_at - _POSE) // stride))
        filled = _Cursor(data + bytes(stride))
        heads = filled.array('<u4', (later, 3), (stride, 4), places_at + _POSE)
        names = filled.array('u1', (later, len(name)), (stride, 1), places_at + _POSE + 12)
        unlike = (heads[:, 2] != len(name)) | (names != np.frombuffer(name, 'u1')).any(axis=1)
        if unlike.any():
            cursor.at = places_at + _POSE + int(unlike.argmax()) * stride + 8
            return PathContent(stamp, frame, [pose_frame, cursor.string()], *nothing)
        poses = cursor.array('<f8', (count, 7), (stride, 8), places_at)
        times = np.append(first, heads[:, 0].astype(int) * 10**9 + heads[:, 1])
        return PathContent(stamp, frame, [pose_frame], times, poses[:, :3])


def read_power(data: bytes) -> PowerContent:
    """Return the content of a power, or raise a PlanError."""
    with _reading():
        labels, _, levels = _read_array(data, _MOST)
        names = labels[1].split(' ') if len(labels) == 2 else []
        return PowerContent(levels, *names if len(names) in (3, 4) else ())


def read_schedule(data: bytes) -> ScheduleContent:
    """Return the content of a schedule, or raise a PlanError."""
    with _reading():
        labels, (nodes, slots, _), values = _read_array(data, MAX_NODES * _MOST)
        _, *names = labels[2].split(' ')
        if len(names) != nodes:
            raise ValueError(f'it names {len(names)} ground nodes and has shares for {nodes}')
        return ScheduleContent(values.reshape(nodes, slots), names)


def _read_array(data: bytes, most: int) -> tuple[list[str], list[int], Array]:
    """Return labels, sizes and values, `most` at most, of a std_msgs/Float64MultiArray."""
    cursor, labels, sizes = _Cursor(data), [], []
    for _ in range(cursor.integer()):
        labels.append(cursor.string())
        sizes.append(cursor.integer())
        cursor.integer()  # The stride.
    cursor.integer()  # The offset of the data.
    count = cursor.count(most)
    return labels, sizes, cursor.array('<f8', (count,), (8,), cursor.align(8))


def read_trajectory(data: bytes) -> TrajectoryContent:
    """Return the content of a trajectory, or raise a PlanError."""
    with _reading():
        cursor = _Cursor(data)
        stamp, frame = cursor.stamp(), cursor.string()
        for _ in range(cursor.integer()):
            cursor.string()  # The name of a joint.
        count = cursor.count()
        nothing = TrajectoryContent(stamp, frame, count, None)
        if not count or cursor.integer() != 1:
            return nothing
        begin = cursor.align(8)
        try:
            numbers = cursor.array('<f8', (count, 22), (_POINT, 8), begin)
            counts = cursor.array('<u4', (count, 44), (_POINT, 4), begin)[:, [14, 28]]
            later = cursor.array('<u4', (count - 1, 1), (_POINT, 4), begin + _POINT - 8)
        except (TypeError, ValueError):
            return nothing
        if (counts != 1).any() or (later != 1).any():
            return nothing
        motion = [numbers[:, at:at + 2] for at in (0, 8, 15)]
        return TrajectoryContent(stamp, frame, count, motion)


@contextmanager
def _reading() -> Iterator[None]:
    try:
        yield
    except (struct.error, TypeError, ValueError, OverflowError, MemoryError) as error:
        raise PlanError(f'a message is not readable: {brief(error)}') from None


class _Cursor:
    """A place in a serialized message."""

    def __init__(self, data: bytes) -> None:
        if data[:2] != b'\0\1':
            raise ValueError(f'its encoding is {data[:2].hex()}; it must be 0001, CDR')
        self._data, self.at = data, 4

    def align(self, size: int) -> int:
        """Advance to a multiple of a size from the end of the encoding."""
        self.at += (4 - self.at) % size
        return self.at

    def integer(self) -> int:
        value, = struct.unpack_from('<I', self._data, self.align(4))
        self.at += 4
        return int(value)

    def count(self, most: int = _MOST) -> int:
        value = self.integer()
        if value > most:
            raise ValueError(f'it has {value} points; at most {most} are allowed')
        return value

    def stamp(self) -> int:
        return self.integer() * 10**9 + self.integer()

    def string(self) -> str:
        length = self.integer()
        text = self._data[self.at:self.at + length]
        if len(text) < length:
            raise ValueError('it ends within a string')
        self.at += length
        return text.rstrip(b'\0').decode()

    def array(self, kind: str, shape: tuple[int, ...], strides: Sequence[int], at: int) -> Array:
        return np.ndarray(shape, kind, self._data, at, strides) if shape[0] else np.empty(shape)
