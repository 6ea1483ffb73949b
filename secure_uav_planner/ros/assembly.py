"""Assembly of a plan from the messages on its topics."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .cdr import (
    PathContent, read_path, read_power, read_schedule, read_trajectory, ScheduleContent,
    TrajectoryContent)
from .parameters import LONGEST_FRAME
from .topics import SCHEDULE
from ..errors import PlanError, quote
from ..mission.fields import COORDINATE, find_range
from ..mission.scenario import Array, GroundNode, Scenario, Uav
from ..model.curve import infer_limits
from ..plan.plan import Plan

_MOST_KEPT = 4  # Messages of a topic.
_IRREGULAR = 0.01  # Largest error of a point's time, as a share of a slot.
_SAME_ALTITUDE = _SAME_PLACE = 1e-3  # m
_UAV_READERS = {'path': read_path, 'power': read_power, 'trajectory': read_trajectory}


class Assembly:
    """
    Collects the messages of plans, which arrive one by one and in any order.

    A power names its plan and the digests of its path and trajectory, and of the schedule of
    several ground nodes: these are the messages of the plan. Powers of other planners name
    nothing; they are joined with the newest paths, and with trajectories of the same stamp on the
    topics that `expects` is true of. Each such message is used for one plan only.

    :ivar missing: topics of the messages that the plan of the last message waits for.
    """

    def __init__(self, names: Sequence[str], expects: Callable[[str], bool]) -> None:
        self._names, self._expects = names, expects
        # The newest of each topic, by key: the identity of a plan, or a digest.
        self._messages: dict[str, dict[str, Any]] = {
            SCHEDULE: {}, **{f'{name}/{kind}': {} for name in names for kind in _UAV_READERS}}
        self._assembled = ''  # Identity of the last plan.
        self.missing: list[str] = []

    def take(self, topic: str, message: bytes, fields: Mapping[str, Any]
             ) -> tuple[Plan, str] | None:
        """
        Keep a serialized message; return the plan that it completes and its frame, or None.

        :param fields: the fields of a Scenario that no message contains.
        :raises PlanningError: if the message cannot be read, or the messages do not make a plan.
            They are kept, because a later message may complete them.
        """
        read = read_schedule if topic == SCHEDULE else _UAV_READERS[topic.partition('/')[2]]
        try:
            content = read(message)
        except PlanError as error:
            raise PlanError(f'{topic}: {error}') from None
        kept = self._messages[topic]
        kept.pop(content.key, None)
        kept[content.key] = content
        if len(kept) > _MOST_KEPT:
            del kept[next(iter(kept))]
        for identity in {key: None for name in self._names
                         for key in ('', *self._messages[f'{name}/power'])}:
            contents = self._collect(identity)
            if not any(part is content for part in contents.values()):
                continue
            self.missing = [topic for topic, part in contents.items() if part is None]
            # A plan may be published again.
            if not self.missing and (not identity or identity != self._assembled):
                plan = _plan_from(self._names, contents, fields)
                self._assembled = identity
                self._forget(contents, identity)
                return plan, contents[f'{self._names[0]}/path'].frame
        return None

    @property
    def problem(self) -> str:
        """Reason why the last message does not make a plan yet, or an empty string."""
        return f'no new message on {", ".join(self.missing)}' if self.missing else ''

    def _forget(self, contents: Mapping[str, Any], identity: str) -> None:
        """Forget powers of plans that a plan replaces, and messages that do not name it."""
        for topic, content in contents.items():
            kept, key = self._messages[topic], content.key
            if topic.endswith('/power'):
                for older in [*kept][:[*kept].index(key)]:
                    del kept[older]
            if not identity:
                del kept[key]

    def _collect(self, identity: str) -> dict[str, Any]:
        """Return the messages of a plan by topic, None for a missing one; '' names no plan."""
        contents: dict[str, Any] = {}
        for name in self._names:
            powers, paths, trajectories = (
                self._messages[f'{name}/{kind}'] for kind in ('power', 'path', 'trajectory'))
            power = powers.get(identity)
            contents[f'{name}/power'] = power
            if not identity:
                named = {digest for content in powers.values()
                         for digest in (content.path, content.trajectory)}
                path, trajectory = (
                    next((kept[key] for key in reversed(kept) if key not in named), None)
                    for kept in (paths, trajectories))
                if None in (path, trajectory) or trajectory.stamp_ns != path.stamp_ns:
                    trajectory = None
                contents[f'{name}/path'] = path
                if trajectory is not None or self._expects(f'{name}/trajectory'):
                    contents[f'{name}/trajectory'] = trajectory
            elif power is not None:
                contents[f'{name}/path'] = paths.get(power.path)
                contents[f'{name}/trajectory'] = trajectories.get(power.trajectory)
                if power.schedule:
                    contents[SCHEDULE] = self._messages[SCHEDULE].get(power.schedule)
        return contents


def _plan_from(names: Sequence[str], contents: Mapping[str, Any], fields: Mapping[str, Any]
               ) -> Plan:
    """Return the Plan in the messages; its limits are the smallest that it keeps."""
    paths = {name: contents[f'{name}/path'] for name in names}
    powers = [contents[f'{name}/power'].levels for name in names]
    slots = len(powers[0])
    _check_frames(paths)
    for name, levels in zip(names, powers, strict=True):
        points = len(paths[name].places)
        if points != slots + 2 or len(levels) != slots or not slots:
            raise PlanError(f'{name} has {points} points and {len(levels)} powers; there must be '
                            'two points more than powers, the same for all')
    start_ns, slot_duration = _timing(paths)
    places, watts = np.array([path.places for path in paths.values()]), np.array(powers)
    _check_values(names, places, watts)
    positions = places[..., :2]
    trajectories = {name: part for name in names
                    if (part := contents.get(f'{name}/trajectory')) is not None}
    for name, trajectory in trajectories.items():
        _check_trajectory(name, trajectory, paths[name])
    motions = {name: trajectory.motion for name, trajectory in trajectories.items()
               if trajectory.motion is not None}
    absent = [name for name in names if name not in motions]
    if motions and absent:
        raise PlanError(
            f'{next(iter(motions))}/trajectory has accelerations, {absent[0]}/trajectory is '
            'missing or has none; there must be all of them, or none')
    limits = infer_limits(positions, slot_duration, [motion[1:] for motion in motions.values()])
    average = np.maximum(watts.mean(axis=1) * (1 + 1e-9), find_range(Uav, 'average_power').low)
    peak = np.maximum(watts.max(axis=1) * (1 + 1e-9), average)
    uavs = tuple(
        Uav(name, tuple(line[0].tolist()), tuple(line[-1].tolist()), float(line_z),
            average_power=float(mean), peak_power=float(most),
            **motion_limits)
        for name, line, line_z, mean, most, motion_limits in zip(
            names, positions, places[:, 0, 2], average, peak, limits, strict=True))
    schedule = contents.get(SCHEDULE)
    if schedule is not None:
        fields = {**fields, 'ground_nodes': _name_nodes(fields['ground_nodes'], schedule)}
    scenario = Scenario(uavs=uavs, duration=slot_duration * slots, slots=slots, **fields)
    plan = Plan(scenario, positions, watts, start_ns=start_ns,
                shares=None if schedule is None else schedule.shares)
    _check_motions(plan, motions)
    return plan


def _name_nodes(nodes: Sequence[GroundNode], schedule: ScheduleContent
                ) -> tuple[GroundNode, ...]:
    """Return the ground nodes with the names of a schedule, or raise a PlanError."""
    if len(nodes) != len(schedule.names):
        raise PlanError(f'the plan serves {", ".join(schedule.names)}, and there are positions of '
                        f'{len(nodes)} ground nodes; there must be that of each')
    return tuple(replace(node, name=name)
                 for node, name in zip(nodes, schedule.names, strict=True))


def _check_trajectory(name: str, trajectory: TrajectoryContent, path: PathContent) -> None:
    """Raise a PlanError if a trajectory cannot be that of a path."""
    if trajectory.frame != path.frame:
        raise PlanError(f'{name}/path is in frame {quote(path.frame)}, '
                        f'{name}/trajectory in {quote(trajectory.frame)}')
    if trajectory.size != len(path.places):
        raise PlanError(f'{name}/trajectory has {trajectory.size} points and {name}/path '
                        f'{len(path.places)}; there must be as many')
    low, high = COORDINATE.low, COORDINATE.high
    if not all(((values >= low) & (values <= high)).all() for values in trajectory.motion or ()):
        raise PlanError(f'{name}/trajectory has values beyond {low:g} to {high:g}')


def _check_motions(plan: Plan, motions: Mapping[str, list[Array]]) -> None:
    """Raise a PlanError if the trajectories are not the curve of the plan."""
    curves = plan.curve.at(plan.times).positions
    for uav, curve in zip(plan.scenario.uavs, curves, strict=True):
        apart = np.linalg.norm(motions.get(uav.name, [curve])[0] - curve, axis=-1)
        if not apart.max() <= _SAME_PLACE:
            raise PlanError(
                f'{uav.name}/trajectory is not the curve of {uav.name}/path: at point '
                f'{apart.argmax()} they are {apart.max():.3g} m apart')


def _check_frames(paths: Mapping[str, PathContent]) -> None:
    frames = {name: path.frame for name, path in paths.items()}
    if len(set(frames.values())) > 1:
        raise PlanError('the paths are in different frames: ' + ', '.join(
            f'{name}/path in {quote(frame)}' for name, frame in list(frames.items())[:4]))
    for name, path in paths.items():
        frame = path.frame
        if len(frame) > LONGEST_FRAME:
            raise PlanError(f'the frame_id of the paths has {len(frame)} characters; it may have '
                            f'{LONGEST_FRAME}')
        if path.pose_frames not in ([], [frame], ['']):
            raise PlanError(f'{name}/path is in frame {quote(frame)} and has a pose in frame '
                            f'{quote(path.pose_frames[-1])}')


def _timing(paths: Mapping[str, PathContent]) -> tuple[int, float]:
    """Return the time of point 0 in ns and the length of a slot in s."""
    stamps = {name: path.stamp_ns for name, path in paths.items()}
    if len(set(stamps.values())) > 1:
        raise PlanError('the paths are of different plans, their stamps differ: ' + ', '.join(
            f'{name}/path {stamp * 1e-9:.3f} s' for name, stamp in list(stamps.items())[:4]))
    times = np.array([path.times_ns for path in paths.values()])
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
    low, high = COORDINATE.low, COORDINATE.high
    most = find_range(Uav, 'peak_power').high
    for name, line, levels in zip(names, places, watts, strict=True):
        if not ((line >= low) & (line <= high)).all():
            raise PlanError(f'{name}/path has coordinates beyond {low:g} to {high:g} m')
        if not ((levels >= 0) & (levels <= most)).all():
            raise PlanError(f'{name}/power has values beyond 0 to {most:g} W')
        climb = np.ptp(line[:, 2])
        if climb > _SAME_ALTITUDE:
            raise PlanError(f'{name}/path climbs by {climb:g} m; the altitude must be constant')
