"""Assembly of a plan from the messages on its topics."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from nav_msgs.msg import Path
import numpy as np
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory

from .messages import nanoseconds
from .parameters import LONGEST_FRAME
from ..errors import PlanError, shown
from ..mission.propagation import Channel
from ..mission.scenario import Array, Eavesdropper, Point, RANGES, Scenario, Uav
from ..model.curve import Curve, flown
from ..plan.plan import Plan

_SETTLING_NS = 100_000_000
_PATIENCE_NS = 2_000_000_000
_IRREGULAR = 0.01  # Largest error of a point's time, as a share of a slot.
_SAME_ALTITUDE = 1e-3
_SAME_PLACE = 1e-3


class Assembly:
    """
    Collects the messages of a plan, which arrive one by one and in any order.

    Every message is used for one plan only, because messages with powers have no stamp, and new
    powers must not be combined with an old path. A plan may have no trajectories. They are waited
    for where somebody publishes them, and one that comes late makes the last plan anew.

    :param names: the names of the UAVs.
    :param expects: whether somebody publishes the trajectory of a UAV, by its name.
    """

    def __init__(self, names: Sequence[str], expects: Callable[[str], bool]) -> None:
        self._names = names
        self._expects = expects
        self._new = _Messages({}, {}, {})
        self._last = _Messages({}, {}, {})
        self._received: int | None = None

    def take(self, name: str, message: Path | Float64MultiArray | MultiDOFJointTrajectory,
             now_ns: int) -> None:
        """Keep a message as the newest of a UAV's topic."""
        if isinstance(message, MultiDOFJointTrajectory):
            self._new.trajectories[name] = message
            # One that comes before everything else of its plan waits in silence.
            if not (self._new.paths or self._new.powers or self._late()):
                return
        elif isinstance(message, Path):
            self._new.paths[name] = message
        else:
            self._new.powers[name] = message
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
        patience = _SETTLING_NS if self._is_complete() else _PATIENCE_NS
        return not 0 <= waited < patience

    def is_whole(self) -> bool:
        """Return whether there is a message of every topic, of which at least one is new."""
        return self._received is not None and self._is_complete()

    def is_arriving(self) -> bool:
        """Return whether some messages of a plan have come and others are still waited for."""
        return self._received is not None and not self._is_complete()

    @property
    def problem(self) -> str:
        """Why the messages that have come do not make a newer plan yet, or an empty string."""
        new = self._new
        if not (new.paths or new.powers):
            return ''
        return f'nothing new has come on {", ".join(self._missing(new))}'

    def plan(self, ground_node: Point, reference_snr_db: float, channel: Channel,
             eavesdropper: Point | None) -> tuple[Plan, str]:
        """
        Return the plan that the messages contain, and its frame.

        :param eavesdropper: (x, y) in m, or None for one at the ground node.
        :raises PlanningError: if the messages do not make a plan. They are kept, because a later
            message may complete them.
        """
        self._received = None
        chosen = self._chosen()
        missing = self._missing(chosen)
        if missing:
            raise PlanError(f'nothing new has come on {", ".join(missing)}')
        found = plan_from(
            self._names, chosen, ground_node, reference_snr_db, channel, eavesdropper)
        self._new, self._last = _Messages({}, {}, {}), chosen
        return found, chosen.paths[self._names[0]].header.frame_id

    def without_trajectory(self) -> list[str]:
        """Return the UAVs of the last plan whose trajectories are published but did not come."""
        return [name for name in self._names
                if name not in self._last.trajectories and self._expects(name)]

    def _chosen(self) -> '_Messages':
        """Return the messages of the next plan, or of the last one and what comes late for it."""
        new = self._new
        if new.paths or new.powers or not self._late():
            return new._replace(trajectories=new.trajectories_of(new.paths))
        return self._last._replace(trajectories={**self._last.trajectories, **self._late()})

    def _late(self) -> dict[str, MultiDOFJointTrajectory]:
        """Return the new trajectories that the last plan was made without."""
        return {name: message
                for name, message in self._new.trajectories_of(self._last.paths).items()
                if name not in self._last.trajectories}

    def _missing(self, chosen: '_Messages') -> list[str]:
        return [f'{name}/{topic}' for topic, kept in (('path', chosen.paths),
                                                      ('power', chosen.powers))
                for name in self._names if name not in kept]

    def _is_complete(self) -> bool:
        chosen = self._chosen()
        return not self._missing(chosen) and all(
            name in chosen.trajectories for name in self._names if self._expects(name))


class _Messages(NamedTuple):
    """The messages of a plan by the names of the UAVs; those without a trajectory fly straight."""

    paths: dict[str, Path]
    powers: dict[str, Float64MultiArray]
    trajectories: dict[str, MultiDOFJointTrajectory]

    def trajectories_of(self, paths: Mapping[str, Path]) -> dict[str, MultiDOFJointTrajectory]:
        """Return the trajectories that have the stamps of paths, as those of one plan do."""
        return {name: message for name, message in self.trajectories.items()
                if name in paths and message.header.stamp == paths[name].header.stamp}


def plan_from(names: Sequence[str], messages: _Messages, ground_node: Point,
              reference_snr_db: float, channel: Channel, eavesdropper: Point | None) -> Plan:
    """
    Return the Plan that messages contain; its limits are the smallest that the plan keeps.

    :param names: the names of the UAVs in their order.
    :param eavesdropper: (x, y) in m of an eavesdropper, or None for one at the ground node.
    :raises PlanningError: if the messages do not fit together.
    """
    paths, powers, trajectories = messages
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
    motions = {name: motion for name, message in trajectories.items()
               if (motion := _motion(name, message, paths[name])) is not None}
    uavs = tuple(
        Uav(name, tuple(line[0].tolist()), tuple(line[-1].tolist()), float(line_z),
            average_power=max(float(level.mean()) * (1 + 1e-9), RANGES['average_power'][0]),
            peak_power=max(float(level.max()) * (1 + 1e-9), RANGES['peak_power'][0]),
            **flown(line, slot_duration, *motions.get(name, [])[1:])._asdict())
        for name, line, line_z, level in zip(
            names, positions, places[:, 0, 2], watts, strict=True))
    scenario = Scenario(
        tuple(ground_node), (Eavesdropper(eavesdropper or tuple(ground_node)),), uavs,
        slot_duration * slots, slots, reference_snr_db, channel=channel)
    plan = Plan(scenario, positions, watts, start_ns=start_ns)
    _check_motions(plan, motions)
    return plan


def _motion(name: str, message: MultiDOFJointTrajectory, path: Path) -> list[Array] | None:
    """
    Return positions, velocities and accelerations at the times of the points, each (N+2, 2).

    :return: None if the trajectory has no velocities or accelerations, as some have.
    """
    if message.header.frame_id != path.header.frame_id:
        raise PlanError(f'{name}/path is in frame {shown(path.header.frame_id)}, '
                        f'{name}/trajectory in {shown(message.header.frame_id)}')
    if len(message.points) != len(path.poses):
        raise PlanError(f'{name}/trajectory has {len(message.points)} points and {name}/path '
                        f'{len(path.poses)}; there must be as many')
    kinds = ('transforms', 'velocities', 'accelerations')
    if not all(getattr(at, kind) for at in message.points for kind in kinds):
        return None
    motion = [np.array([(vector.x, vector.y) for at in message.points
                        for vector in [getattr(getattr(at, kind)[0], part)]])
              for kind, part in zip(kinds, ('translation', 'linear', 'linear'), strict=True)]
    low, high = RANGES['coordinate']
    if not all(((values >= low) & (values <= high)).all() for values in motion):
        raise PlanError(f'{name}/trajectory has values beyond {low:g} to {high:g}')
    return motion


def _check_motions(plan: Plan, motions: Mapping[str, list[Array]]) -> None:
    """Compare the curve of a plan with the trajectories that it was made from."""
    expected = Curve(plan.scenario, plan.positions).at(plan.times)
    for index, uav in enumerate(plan.scenario.uavs):
        if uav.name not in motions:
            continue
        apart = np.linalg.norm(
            motions[uav.name][0] - expected.positions[index], axis=-1)
        if not apart.max() <= _SAME_PLACE:
            raise PlanError(
                f'{uav.name}/trajectory is not the curve of {uav.name}/path: at point '
                f'{apart.argmax()} they are {apart.max():.3g} m apart')


def _check_frames(paths: Mapping[str, Path]) -> None:
    frames = {name: path.header.frame_id for name, path in paths.items()}
    if len(set(frames.values())) > 1:
        raise PlanError('the paths are in different frames: ' + ', '.join(
            f'{name}/path in {shown(frame)}' for name, frame in list(frames.items())[:4]))
    longest = max(map(len, frames.values()))
    if longest > LONGEST_FRAME:
        raise PlanError(f'the frame_id of the paths has {longest} characters; it may have '
                        f'{LONGEST_FRAME}')
    for name, path in paths.items():
        for at in path.poses:
            if at.header.frame_id not in ('', path.header.frame_id):
                raise PlanError(f'{name}/path is in frame {shown(path.header.frame_id)} and has '
                                f'a pose in frame {shown(at.header.frame_id)}')


def _timing(paths: Mapping[str, Path]) -> tuple[int, float]:
    """Return the time of point 0 in ns and the length of a slot in s."""
    stamps = {name: nanoseconds(path.header.stamp) for name, path in paths.items()}
    if len(set(stamps.values())) > 1:
        raise PlanError('the paths are of different plans, their stamps differ: ' + ', '.join(
            f'{name}/path {stamp * 1e-9:.3f} s' for name, stamp in list(stamps.items())[:4]))
    times = np.array([[nanoseconds(at.header.stamp) for at in path.poses]
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
    low, high = RANGES['coordinate']
    most = RANGES['peak_power'][1]
    for name, line, levels in zip(names, places, watts, strict=True):
        if not ((line >= low) & (line <= high)).all():
            raise PlanError(f'{name}/path has coordinates beyond {low:g} to {high:g} m')
        if not ((levels >= 0) & (levels <= most)).all():
            raise PlanError(f'{name}/power has values beyond 0 to {most:g} W')
        if np.ptp(line[:, 2]) > _SAME_ALTITUDE:
            raise PlanError(f'{name}/path climbs by {np.ptp(line[:, 2]):g} m; the altitude must '
                            f'be constant')
