"""Assembly of a plan from the messages on its topics."""

from collections.abc import Mapping, Sequence

from nav_msgs.msg import Path
import numpy as np
from std_msgs.msg import Float64MultiArray

from ..errors import PlanError, shown
from ..plan import Plan
from ..scenario import Array, Eavesdropper, LIMITS, Point, Scenario, Uav

_SETTLING_NS = 100_000_000
_PATIENCE_NS = 2_000_000_000
_IRREGULAR = 0.01  # Largest error of a point's time, as a share of a slot.
_SAME_ALTITUDE = 1e-3


class Assembly:
    """
    Collects the messages of a plan, which arrive one by one and in any order.

    Every message is used for one plan only, because messages with powers have no stamp, and new
    powers must not be combined with an old path.

    :param names: the names of the UAVs.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._paths: dict[str, Path] = {}
        self._powers: dict[str, Float64MultiArray] = {}
        self._received: int | None = None

    def take(self, name: str, message: Path | Float64MultiArray, now_ns: int) -> None:
        """Keep a message as the newest of a UAV's topic."""
        kept = self._paths if isinstance(message, Path) else self._powers
        kept[name] = message
        self._received = now_ns

    def is_due(self, now_ns: int) -> bool:
        """
        Return whether plan() should be called now.

        That is so when a complete set has arrived and then no message for a short time, or when
        the rest of a set has been missing for too long.
        """
        if self._received is None:
            return False
        # After the clock has jumped back, do not wait.
        waited = now_ns - self._received
        patience = _PATIENCE_NS if self._missing() else _SETTLING_NS
        return not 0 <= waited < patience

    def is_whole(self) -> bool:
        """Return whether there is a message of every topic, of which at least one is new."""
        return self._received is not None and not self._missing()

    def plan(self, ground_node: Point, reference_snr_db: float, eavesdropper: Point | None
             ) -> tuple[Plan, str]:
        """
        Return the plan that the messages contain, and its frame.

        :param eavesdropper: (x, y) in m, or None for one at the ground node.
        :raises PlanningError: if the messages do not make a plan. They are kept, because a later
            message may complete them.
        """
        self._received = None
        missing = self._missing()
        if missing:
            raise PlanError(f'nothing new has come on {", ".join(missing)}')
        found = plan_from(self._names, self._paths, self._powers, ground_node, reference_snr_db,
                          eavesdropper)
        frame_id = self._paths[self._names[0]].header.frame_id
        self._paths, self._powers = {}, {}
        return found, frame_id

    def _missing(self) -> list[str]:
        return [f'{name}/{topic}' for topic, kept in (('path', self._paths),
                                                      ('power', self._powers))
                for name in self._names if name not in kept]


def plan_from(names: Sequence[str], paths: Mapping[str, Path],
              powers: Mapping[str, Float64MultiArray], ground_node: Point,
              reference_snr_db: float, eavesdropper: Point | None) -> Plan:
    """
    Return the Plan that messages contain; its limits are the smallest that the plan keeps.

    :param names: the names of the UAVs in their order.
    :param paths: the Path of every UAV by name.
    :param powers: the Float64MultiArray of every UAV by name.
    :param eavesdropper: (x, y) in m of an eavesdropper, or None for one at the ground node.
    :raises PlanningError: if the messages do not fit together.
    """
    slots = len(powers[names[0]].data)
    for name in names:
        points, watts = len(paths[name].poses), len(powers[name].data)
        if points != slots + 2 or watts != slots or not slots:
            raise PlanError(f'{name} has {points} points and {watts} powers; there must be two '
                            f'points more than powers, the same for all')
    _check_frames({name: paths[name] for name in names})
    start_ns, slot_duration = _timing({name: paths[name] for name in names})
    places = np.array([[(at.pose.position.x, at.pose.position.y, at.pose.position.z)
                        for at in paths[name].poses] for name in names])
    watts = np.array([powers[name].data for name in names], dtype=float)
    _check_values(names, places, watts)
    positions = places[..., :2]
    speeds = np.linalg.norm(np.diff(positions, axis=1), axis=-1).max(axis=1) / slot_duration
    uavs = tuple(
        Uav(name, tuple(line[0].tolist()), tuple(line[-1].tolist()), float(line_z),
            max(speed * (1 + 1e-9), LIMITS['max_speed'][0]),
            max(float(level.mean()) * (1 + 1e-9), LIMITS['average_power'][0]),
            max(float(level.max()) * (1 + 1e-9), LIMITS['peak_power'][0]))
        for name, line, line_z, speed, level in zip(
            names, positions, places[:, 0, 2], speeds.tolist(), watts, strict=True))
    scenario = Scenario(
        tuple(ground_node), (Eavesdropper(eavesdropper or tuple(ground_node)),), uavs,
        slot_duration * slots, slots, reference_snr_db)
    return Plan(scenario, positions, watts, start_ns=start_ns)


def _check_frames(paths: Mapping[str, Path]) -> None:
    frames = {name: path.header.frame_id for name, path in paths.items()}
    if len(set(frames.values())) > 1:
        raise PlanError('the paths are in different frames: ' + ', '.join(
            f'{name}/path in {shown(frame)}' for name, frame in list(frames.items())[:4]))
    for name, path in paths.items():
        for at in path.poses:
            if at.header.frame_id not in ('', path.header.frame_id):
                raise PlanError(f'{name}/path is in frame {shown(path.header.frame_id)} and has '
                                f'a pose in frame {shown(at.header.frame_id)}')


def _timing(paths: Mapping[str, Path]) -> tuple[int, float]:
    """Return the time of point 0 in ns and the length of a slot in s."""
    stamps = {name: _nanoseconds(path.header.stamp) for name, path in paths.items()}
    if len(set(stamps.values())) > 1:
        raise PlanError('the paths are of different plans, their stamps differ: ' + ', '.join(
            f'{name}/path {stamp * 1e-9:.3f} s' for name, stamp in list(stamps.items())[:4]))
    times = np.array([[_nanoseconds(at.header.stamp) for at in path.poses]
                      for path in paths.values()])
    first, step = times[0, 0], (times[0, -1] - times[0, 0]) / (times.shape[1] - 1)
    if not step > 0:
        raise PlanError('the stamps of the poses do not increase')
    regular = first + step * np.arange(times.shape[1])
    # In units of a slot. Stamps are rounded by up to one nanosecond.
    off = (np.abs(times - regular) - 1.0) / step
    if off.max() > _IRREGULAR:
        name, point = np.unravel_index(np.argmax(off), off.shape)
        raise PlanError(f'the stamps of the poses must be equally spaced and the same for all; '
                        f'point {point} of {list(paths)[name]}/path is {off.max():.3g} slots off')
    return int(first), float(step) * 1e-9


def _check_values(names: Sequence[str], places: Array, watts: Array) -> None:
    low, high = LIMITS['coordinate']
    most = LIMITS['peak_power'][1]
    for name, line, levels in zip(names, places, watts, strict=True):
        if not ((line >= low) & (line <= high)).all():
            raise PlanError(f'{name}/path has coordinates beyond {low:g} to {high:g} m')
        if not ((levels >= 0) & (levels <= most)).all():
            raise PlanError(f'{name}/power has values beyond 0 to {most:g} W')
        if np.ptp(line[:, 2]) > _SAME_ALTITUDE:
            raise PlanError(f'{name}/path climbs by {np.ptp(line[:, 2]):g} m; the altitude must '
                            f'be constant')


def _nanoseconds(stamp: object) -> int:
    return stamp.sec * 10**9 + stamp.nanosec
