"""Assembly of a plan from the messages on its topics."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .cdr import PathContent, read_path, read_power, read_trajectory, stamp_of
from .parameters import LONGEST_FRAME
from ..errors import PlanError, quote
from ..mission.scenario import Array, RANGES, Scenario, Uav
from ..model.curve import infer_limits
from ..plan.plan import Plan

_SETTLING_NS = 100_000_000
_PATIENCE_NS = 2_000_000_000
_IRREGULAR = 0.01  # Largest error of a point's time, as a share of a slot.
_SAME_ALTITUDE = _SAME_PLACE = 1e-3  # m


class Assembly:
    """
    Collects the messages of a plan, which arrive one by one and in any order.

    Each message is used for one plan only, because powers have no stamp, and new powers must not
    be combined with an old path. Trajectories are optional: a plan waits for those on topics that
    `expects` is true of, and a late one makes the last plan anew.
    """

    def __init__(self, names: Sequence[str], expects: Callable[[str], bool]) -> None:
        self._names, self._expects = names, expects
        self._needed = [f'{name}/{kind}' for kind in ('path', 'power') for name in names]
        self._optional = [f'{name}/trajectory' for name in names]
        self._new: dict[str, bytes] = {}  # Messages by their topics, since the last plan.
        self._last: dict[str, bytes] = {}  # Those of the last plan.
        self._received: int | None = None

    def take(self, topic: str, message: bytes, now_ns: int) -> None:
        """Keep a serialized message as the newest of its topic."""
        self._new[topic] = message
        # A trajectory that comes before the rest of its plan does not begin the wait for that.
        if self._has_begun() or self._late():
            self._received = now_ns

    def is_due(self, now_ns: int) -> bool:
        """Return True if a set is complete and settled, or its rest has been missing too long."""
        if self._received is None:
            return False
        # After the clock has jumped back, do not wait.
        patience = _PATIENCE_NS if self._missing() else _SETTLING_NS
        return not 0 <= now_ns - self._received < patience

    def is_whole(self) -> bool:
        """Return True if there is a message of each topic, and at least one is new."""
        return self._received is not None and not self._missing()

    def is_arriving(self) -> bool:
        """Return True if messages of a plan have come, but not all."""
        return self._received is not None and bool(self._missing())

    @property
    def problem(self) -> str:
        """Reason why the new messages do not make a plan yet, or an empty string."""
        missing = self._missing() if self._has_begun() else []
        return _nothing_on(missing) if missing else ''

    def plan(self, **fields: Any) -> tuple[Plan, str]:
        """
        Return the plan in the messages, and its frame.

        :param fields: the fields of its Scenario that no message contains.
        :raises PlanningError: if the messages do not make a plan. They are kept, because a later
            message may complete them.
        """
        self._received = None
        chosen = self._chosen()
        missing = [topic for topic in self._needed if topic not in chosen]
        if missing:
            raise PlanError(_nothing_on(missing))
        paths = {name: read_path(chosen[f'{name}/path']) for name in self._names}
        plan = _plan_from(paths, chosen, fields)
        self._new, self._last = {}, chosen
        return plan, paths[self._names[0]].frame

    def without_trajectory(self) -> list[str]:
        """Return the expected trajectories that the last plan has not."""
        return [topic for topic in self._optional
                if topic not in self._last and self._expects(topic)]

    def _has_begun(self) -> bool:
        """Return True if a path or a power is new."""
        return any(topic in self._new for topic in self._needed)

    def _chosen(self) -> dict[str, bytes]:
        """Messages of the plan being assembled; late trajectories are merged into the last."""
        if not self._has_begun() and (late := self._late()):
            return self._last | late
        return self._trajectories(self._new) | {
            topic: self._new[topic] for topic in self._needed if topic in self._new}

    def _late(self) -> dict[str, bytes]:
        """Return the new trajectories that the last plan has not."""
        return {topic: message for topic, message in self._trajectories(self._last).items()
                if topic not in self._last}

    def _trajectories(self, plan: Mapping[str, bytes]) -> dict[str, bytes]:
        """Return the new trajectories that have the stamps of a plan's paths."""
        return {f'{name}/trajectory': self._new[f'{name}/trajectory'] for name in self._names
                if f'{name}/path' in plan and f'{name}/trajectory' in self._new and (
                    stamp_of(self._new[f'{name}/trajectory'])
                    == stamp_of(plan[f'{name}/path']))}

    def _missing(self) -> list[str]:
        """Return the topics of the messages that the plan waits for."""
        chosen = self._chosen()
        return [topic for topic in (*self._needed, *filter(self._expects, self._optional))
                if topic not in chosen]


def _nothing_on(topics: Sequence[str]) -> str:
    return f'nothing new has come on {", ".join(topics)}'


def _plan_from(paths: Mapping[str, PathContent], messages: Mapping[str, bytes],
               fields: Mapping[str, Any]) -> Plan:
    """Return the Plan in the messages; its limits are the smallest that it keeps."""
    names, powers = list(paths), [read_power(messages[f'{name}/power']) for name in paths]
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
    motions = {name: motion for name in names if f'{name}/trajectory' in messages and (
        motion := _motion(name, messages[f'{name}/trajectory'], paths[name])) is not None}
    average = np.maximum(watts.mean(axis=1) * (1 + 1e-9), RANGES['average_power'][0])
    peak = np.maximum(watts.max(axis=1) * (1 + 1e-9), average)
    uavs = tuple(
        Uav(name, tuple(line[0].tolist()), tuple(line[-1].tolist()), float(line_z),
            average_power=float(mean), peak_power=float(most),
            **infer_limits(line, slot_duration, *motions.get(name, [])[1:]))
        for name, line, line_z, mean, most in zip(
            names, positions, places[:, 0, 2], average, peak, strict=True))
    scenario = Scenario(uavs=uavs, duration=slot_duration * slots, slots=slots, **fields)
    plan = Plan(scenario, positions, watts, start_ns=start_ns)
    _check_motions(plan, motions)
    return plan


def _motion(name: str, message: bytes, path: PathContent) -> list[Array] | None:
    """Return positions, velocities and accelerations at the points, (N+2, 2) each, or None."""
    frame, size, motion = read_trajectory(message)
    if frame != path.frame:
        raise PlanError(f'{name}/path is in frame {quote(path.frame)}, '
                        f'{name}/trajectory in {quote(frame)}')
    if size != len(path.places):
        raise PlanError(f'{name}/trajectory has {size} points and {name}/path '
                        f'{len(path.places)}; there must be as many')
    low, high = RANGES['coordinate']
    if not all(((values >= low) & (values <= high)).all() for values in motion or ()):
        raise PlanError(f'{name}/trajectory has values beyond {low:g} to {high:g}')
    return motion


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
        if path.pose_frames not in ([frame], ['']):
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
    low, high = RANGES['coordinate']
    most = RANGES['peak_power'][1]
    for name, line, levels in zip(names, places, watts, strict=True):
        if not ((line >= low) & (line <= high)).all():
            raise PlanError(f'{name}/path has coordinates beyond {low:g} to {high:g} m')
        if not ((levels >= 0) & (levels <= most)).all():
            raise PlanError(f'{name}/power has values beyond 0 to {most:g} W')
        climb = np.ptp(line[:, 2])
        if climb > _SAME_ALTITUDE:
            raise PlanError(f'{name}/path climbs by {climb:g} m; the altitude must be constant')
