"""Bags of ROS 2 (a folder, .db3 or .mcap), read by rosbags; no ROS is needed."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .course import Course
from .log import Samples, VehicleLog
from ...errors import LogFileError, PlanFileError
from ...plan.file import parse_text
from ...plan.plan import Plan
from ...plan.tracking import PUNCTUAL

_TYPES = {'odom': 'nav_msgs/msg/Odometry', 'power': 'std_msgs/msg/Float64',
          'plan': 'std_msgs/msg/String', 'plan_time': 'sensor_msgs/msg/TimeReference'}
_RESTART_NS = 10**9  # A plan whose time goes back by more is flown again.


class Report(NamedTuple):
    """A follower's report on plan_time: clock and time of the plan in ns, and its identity."""

    clock_ns: int
    plan_ns: int
    identity: str


def find_starts(plan: Plan) -> tuple[int, ...]:
    """Return the start of a plan [ns]; of one without, the starts that `plan --mcap` records."""
    if plan.start_ns is not None:
        return (plan.start_ns,)
    return 0, round(-plan.curve.begin * 1e9)  # Version 0.1.0 has 0, this one the other.


@dataclass
class FlightBag:
    """
    What a bag says of a flight.

    :ivar origin_ns: time 0 of the logs' clock, in ns of the clock in the headers.
    :ivar logs: the log of each UAV by name.
    :ivar plans: the plans in the order in which they were published, with that time in ns.
    :ivar reports: reports of followers in the order of their times.
    """

    origin_ns: int
    logs: dict[str, VehicleLog]
    plans: list[tuple[int, Plan]]
    reports: list[Report]

    def follow(self, plan: Plan) -> tuple[dict[str, VehicleLog], Course]:
        """
        Return the logs with the times of a plan added, and the course of the plan and its replans.

        The reports on plan_time of the last flight give the times and the course. In a bag without
        reports, the logs get no times, and a plan is in force from its publication on.

        :raises LogFileError: for a bag without a flight of this plan.
        """
        for start_ns in find_starts(plan):
            recorded = replace(plan, start_ns=start_ns)
            if recorded.identity in self._list_identities():
                plan = recorded
        start_ns = plan.start_ns or 0
        revisions = self._find_revisions(plan)
        if not self.reports:
            times = [(item.identity, (time_ns - start_ns) * 1e-9) for time_ns, item in self.plans]
            return self.logs, _make_course(
                [pair for pair in times if pair[0] in revisions], revisions, plan)
        flown, notes = self._find_last_flight(revisions, plan)
        for identity, revision in revisions.items():
            revisions[identity] = ended = _end_promise(revision, flown)
            if ended is not revision:
                notes.append(f'the promise of {identity} ends at {ended.promised_until:.1f} s: '
                             'the flight was early or late for receivers that move')
        course = _make_course([(report.identity, (report.plan_ns - start_ns) * 1e-9)
                               for report in flown], revisions, plan)
        plan_times = _find_plan_times(flown, self.origin_ns, start_ns)
        if plan_times is None:
            notes.append('plan_time does not advance: by it, the plan was not flown')
        return {name: replace(log, plan_times=plan_times, notes=(*log.notes, *notes))
                for name, log in self.logs.items()}, course

    def _list_identities(self) -> list[str]:
        """Return the identities of the plans that were published, then of plans flown."""
        return [*(item.identity for _, item in self.plans),
                *(report.identity for report in self.reports)]

    def _find_revisions(self, plan: Plan) -> dict[str, Plan]:
        """
        Return by identity the given plan, and each published plan with the same start and times.

        :raises LogFileError: if plans were published or flown, and the given one was not.
        """
        plans = {item.identity: item for item in (plan, *(item for _, item in self.plans))}
        others = self._list_identities()
        if others and plan.identity not in others:
            raise LogFileError(f'it is a flight of the plan {others[-1]}; the plan that was given '
                               f'is {plan.identity}')
        return {identity: item for identity, item in plans.items()
                if item.start_ns == plan.start_ns
                and np.array_equal(item.scenario.times, plan.scenario.times)}

    def _find_last_flight(self, revisions: dict[str, Plan], plan: Plan
                          ) -> tuple[list[Report], list[str]]:
        """
        Return the reports of the last flight, and notes on earlier flights and other plans.

        A new flight begins where the reported time of the plan goes back by over _RESTART_NS.

        :param revisions: the plan and its replans by identity.
        :raises LogFileError: if no report has the identity of a revision.
        """
        flown = [report for report in self.reports if report.identity in revisions]
        if not flown:
            raise LogFileError(f'the plan {plan.identity} was published in it and not flown')
        notes = []
        restarts = np.flatnonzero(np.diff([report.plan_ns for report in flown]) < -_RESTART_NS)
        edges = [0, *(restarts + 1), len(flown)]
        # After a reset, the plan waits at its start: this is no flight.
        flights = [part for part in (flown[begin:end] for begin, end in zip(edges, edges[1:]))
                   if part[-1].plan_ns > part[0].plan_ns]
        if len(flights) > 1:
            notes.append(f'the plan was begun {len(flights)} times: the last flight counts')
        others = dict.fromkeys(report.identity for report in self.reports)
        return (flights or [flown])[-1], notes + [
            f'the plan {identity} was flown, too: it is compared if it is given'
            for identity in others if identity not in revisions]


def _make_course(in_force: Iterable[tuple[str, float]], plans: dict[str, Plan], given: Plan
                 ) -> Course:
    """
    Return the course of plans that replace each other.

    :param in_force: (identity of the plan in force, time [s] from point 0), in order of time.
    :param plans: the plans by identity.
    :param given: the only plan of the course if `in_force` is empty.
    """
    changes: list[tuple[str, float]] = []
    for identity, time in in_force:
        if not changes or changes[-1][0] != identity:
            changes.append((identity, time))
    if not changes:
        return Course((given,))
    return Course(tuple(plans[identity] for identity, _ in changes),
                  (-np.inf, *(time for _, time in changes[1:])))


def _end_promise(plan: Plan, reports: Sequence[Report]) -> Plan:
    """
    Return a plan whose promise ends before the slot of its first report that is early or late.

    A promise for receivers that move holds at the planned times only: |due - time| <= PUNCTUAL,
    where due = promise_speed * (clock - start - promise_delay) is the planned time at a report. A
    UAV that waits at its start for the planned time, or is at its goal, keeps the promise. A plan
    without a start time starts when its time first advances.
    """
    if not plan.scenario.has_tracks and plan.promised_until is None:
        return plan
    start_ns, curve = plan.start_ns or 0, plan.curve
    begin_ns = start_ns if plan.start_ns is not None else next(
        (after.clock_ns - after.plan_ns for report, after in zip(reports, reports[1:])
         if after.plan_ns > report.plan_ns), 0)
    for report in reports:
        time = (report.plan_ns - start_ns) * 1e-9
        due = plan.promise_speed * ((report.clock_ns - begin_ns) * 1e-9 - plan.promise_delay)
        is_waiting = time <= curve.begin + PUNCTUAL and due < time
        if report.identity == plan.identity and time < curve.end - PUNCTUAL and (
                abs(due - time) > PUNCTUAL and not is_waiting):
            return plan.end_promise(max(time, 0.0))
    return plan


def _find_plan_times(reports: Sequence[Report], origin_ns: int, start_ns: int) -> Samples | None:
    """
    Return times [s] of reports: on the log's clock from origin_ns, of the plan from start_ns.

    None is returned for reports of a plan whose time never advances.
    """
    clock_ns, plan_ns = np.array([report[:2] for report in reports]).T
    clock, flown = (clock_ns - origin_ns) * 1e-9, (plan_ns - start_ns) * 1e-9
    advances = np.diff(plan_ns) > 0
    before, after = np.append(False, advances), np.append(advances, False)
    # While the plan's time stands, only the first and the last report are kept.
    counts = before | after
    if not counts.any():
        return None
    # The plan's time begins or ceases to stand between two reports. It advances there at the pace
    # [s of the clock for each s of the plan] of the next or the last whole step.
    steps = np.diff(flown)
    paces = np.diff(clock) / np.where(advances, steps, np.inf)
    ends = np.flatnonzero(before[2:] & before[1:-1] & ~after[2:]) + 2
    begins = np.flatnonzero(after[:-2] & after[1:-1] & ~before[:-2])
    latest = clock[ends - 1] + steps[ends - 1] * paces[ends - 2]
    earliest = clock[begins + 1] - steps[begins] * paces[begins + 1]
    clock[ends] = np.minimum(clock[ends], latest)
    clock[begins] = np.maximum(clock[begins], earliest)
    return clock[counts], flown[counts]


def read_bag(path: str | os.PathLike[str], uavs: Sequence[str], plan: Plan) -> FlightBag:
    """
    Return the flight of UAVs in a bag by their odometry, such as `<uav>/odom` in any namespace.

    Topics `plan`, `plan_time` and `<uav>/setpoint/power` are read as well, if the bag has them. Of
    several teams, each in a namespace, the one that has or flies the plan is read.
    The clock of a log is the one in the headers of its odometry, which may be simulated. Messages
    without a header get a time of this clock by interpolation over times of arrival: of plan_time,
    whose sender sends the powers, too, and in a bag without it, of the odometry.
    """
    messages = _read_messages(path, uavs, plan)
    flying = [uav for uav in uavs if messages.states[uav]]
    if not flying:
        raise LogFileError(f'it has no odometry of {uavs[0]} (a topic {uavs[0]}/odom)')
    origin_ns = min(header for uav in flying for _, header in messages.clocks[uav])
    stamps, headers = np.array([pair for uav in ([''] if messages.reports else flying)
                                for pair in messages.clocks[uav]]).T
    order = np.argsort(stamps, kind='stable')
    arrival_ns = int(stamps.min())

    def to_clock(times_ns: Any) -> Any:
        """Return times [ns] of the headers' clock from origin_ns at times of arrival [ns]."""
        times, known = np.asarray(times_ns) - arrival_ns, stamps[order] - arrival_ns
        inside = np.clip(times, known[0], known[-1])  # The clock runs on before and after.
        return np.interp(inside, known, headers[order] - origin_ns) + times - inside

    logs = {}
    for uav in flying:
        state, powers = np.array(messages.states[uav]), messages.powers[uav]
        times = (np.array([header for _, header in messages.clocks[uav]]) - origin_ns) * 1e-9
        logs[uav] = VehicleLog(
            times, state[:, :3], state[:, 3:], origin_ns * 1e-9, notes=tuple(messages.notes),
            powers=(to_clock([stamp for stamp, _ in powers]) * 1e-9,
                    np.array([watts for _, watts in powers])) if powers else None)
    return FlightBag(origin_ns, logs, [
        (origin_ns + int(to_clock(stamp)), plan) for stamp, plan in messages.plans],
        sorted(messages.reports))


class _Messages(NamedTuple):
    """
    What is read of a bag's messages, with times of arrival in ns where not said otherwise.

    :ivar states: (x, y, z, u, v) of each UAV in m and m/s.
    :ivar clocks: for each of these states, and by '' for each of the reports, the times of arrival
        and of the header.
    :ivar powers: pairs of a time and a power [W] of each UAV.
    :ivar plans: pairs of a time and a plan.
    :ivar reports: reports on plan_time.
    :ivar notes: what could not be read, in words.
    """

    states: dict[str, list[tuple[float, ...]]]
    clocks: dict[str, list[tuple[int, int]]]
    powers: dict[str, list[tuple[int, float]]]
    plans: list[tuple[int, Plan]]
    reports: list[Report]
    notes: list[str]


def _read_messages(path: str | os.PathLike[str], uavs: Sequence[str], plan: Plan) -> _Messages:
    """Return the messages of a bag on the topics that _choose_topics picks for UAVs."""
    from rosbags.highlevel import AnyReader  # Here, since few need it.
    from rosbags.typesys import get_typestore, Stores
    read = _Messages({uav: [] for uav in uavs}, {uav: [] for uav in ('', *uavs)},
                     {uav: [] for uav in uavs}, [], [], [])
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        team = _find_team(reader, plan)
        roles = dict(_choose_topics(reader.connections, uavs, team))
        for connection, stamp, data in reader.messages(connections=[
                item for item in reader.connections if item.topic in roles]):
            role, uav = roles[connection.topic]
            message: Any = reader.deserialize(data, connection.msgtype)
            if role == 'odom':
                read.clocks[uav].append((stamp, _nanoseconds(message.header.stamp) or stamp))
                read.states[uav].append(_list_state(message))
            elif role == 'power':
                read.powers[uav].append((stamp, float(message.data)))
            elif role == 'plan_time':
                read.reports.append(_make_report(message))
                read.clocks[''].append((stamp, read.reports[-1].clock_ns))
            else:
                try:
                    read.plans.append((stamp, parse_text(message.data, Plan)[0]))
                except PlanFileError as error:
                    read.notes.append(f'{connection.topic} has no plan: {error}')
    return read


def _find_team(reader: Any, plan: Plan) -> list[str] | None:
    """
    Return the parts of the namespace in which a plan is flown; if in none, where it is published.

    None is returned for one team, whose topics may be in several namespaces, and for none.
    """
    identities = {plan.identity, *(
        replace(plan, start_ns=start_ns).identity for start_ns in find_starts(plan))}
    by_role = {role: [item for item in reader.connections
                      if item.topic.rpartition('/')[2] == role and item.msgtype == _TYPES[role]]
               for role in ('plan_time', 'plan')}
    if all(len({item.topic for item in topics}) < 2 for topics in by_role.values()):
        return None
    for role, topics in by_role.items():
        # Without connections, the reader would return all messages.
        for connection, _, data in reader.messages(connections=topics) if topics else ():
            message = reader.deserialize(data, connection.msgtype)
            with suppress(PlanFileError):
                found = _make_report(message) if role == 'plan_time' else (
                    parse_text(message.data, Plan)[0])
                if found.identity in identities:
                    return _split(connection.topic)[:-1]
    return None


def _choose_topics(connections: Iterable[Any], uavs: Sequence[str], team: list[str] | None
                   ) -> Iterator[tuple[str, tuple[str, str]]]:
    """
    Yield (topic, (role, UAV)) of each topic that is read; '' is the UAV of plan and plan_time.

    Each UAV has one odometry topic with its name, preferably ending in `<uav>/odom`, and one topic
    of its power. A single UAV may have an odometry topic without its name. Topics in namespaces of
    other teams are left out. A plan or plan_time elsewhere is read if the team's namespace has no
    topic of this role.

    :param team: parts of the team's namespace; None for one team, in any namespaces.
    """
    kinds = {item.topic: item.msgtype for item in connections}
    parts = {topic: _split(topic) for topic in kinds}
    roles = {topic: parts[topic][-1] for topic, kind in kinds.items()
             if parts[topic][-1] in ('plan', 'plan_time') and kind == _TYPES[parts[topic][-1]]}
    teams = {topic: parts[topic][:-1] for topic in roles}
    own_roles = [role for topic, role in roles.items() if teams[topic] == team]
    for topic, role in roles.items():
        if teams[topic] == team or role not in own_roles:
            yield topic, (role, '')

    def is_foreign(topic: str) -> bool:
        """Return whether a topic lies in the namespace of another team."""
        owners = [owner for owner in teams.values() if parts[topic][:len(owner)] == owner]
        return team is not None and bool(owners) and max(owners, key=len) != team

    topics = sorted((topic for topic in kinds if not is_foreign(topic)),
                    key=lambda topic: (len(parts[topic]), topic))
    for uav in uavs:
        odometry = [topic for topic in topics if kinds[topic] == _TYPES['odom']
                    and (uav in parts[topic] or len(uavs) == 1)]
        if odometry:
            yield min(odometry, key=lambda topic: (
                uav not in parts[topic], parts[topic][-2:] != [uav, 'odom'])), ('odom', uav)
        powers = [topic for topic in topics if kinds[topic] == _TYPES['power']
                  and parts[topic][-3:] == [uav, 'setpoint', 'power']]
        if powers:
            yield powers[0], ('power', uav)


def _split(topic: str) -> list[str]:
    """Return the parts of a topic's name."""
    return topic.strip('/').split('/')


def _make_report(message: Any) -> Report:
    """Return the Report of a message on plan_time."""
    return Report(_nanoseconds(message.header.stamp), _nanoseconds(message.time_ref),
                  message.source.partition(' ')[0])


def _nanoseconds(stamp: Any) -> int:
    """Return a stamp in ns."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _list_state(message: Any) -> tuple[float, ...]:
    """Return x, y, z [m] and velocity in x and y [m/s] of a vehicle in the fixed frame."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    twist = message.twist.twist.linear  # It is in the child frame, of a vehicle that tilts.
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    if message.child_frame_id == message.header.frame_id:
        x, y, z, w = 0.0, 0.0, 0.0, 1.0
    rows = ((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)))
    return (place.x, place.y, place.z,
            *(a * twist.x + b * twist.y + c * twist.z for a, b, c in rows))
