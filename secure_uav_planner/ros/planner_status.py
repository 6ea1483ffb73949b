"""
The status of the planner, as `~/status` and /diagnostics carry it.

The key of a value in the message is the path of its field: `status.track.time` has the key
`track.time`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, Field, field, fields, is_dataclass
import math
from typing import Any, cast, get_args, get_origin, get_type_hints, TypeAlias

from diagnostic_msgs.msg import DiagnosticStatus

from .messages import diagnostic_status
from ..errors import OptionError, quote

_GROUP = '_group'
"""Name in metadata: the value of a field has the key of the group that the field is in."""

_Node: TypeAlias = dict[str | None, Any]
"""The values of a message as a tree by the parts of their keys; the text of a key is at None."""


def _value(meaning: str, default: object = math.nan, **metadata: object) -> Any:
    """Return a field for a value with a meaning; None is not sent, and NaN is sent as `none`."""
    return field(default=default, metadata={'meaning': meaning, **metadata})


def _values(meaning: str, member: str) -> Any:
    """Return a field for values by the name of a member, such as 'uav'."""
    return field(default_factory=dict, metadata={'meaning': meaning, 'member': f'.<{member}>'})


@dataclass(frozen=True)
class OutcomeStatus:
    """The outcome of the last request or replan."""

    code: str = _value('`ok`, or the code of the error of the last request or replan', '')


@dataclass(frozen=True)
class ProgressStatus:
    """The last iteration of the present solve."""

    iteration: int = _value('during a solve: its last iteration', 0)
    step: str = _value('during a solve: kind of the last iteration', '')
    rate: float = _value('during a solve: the rate so far, bit/s/Hz')
    elapsed: float = _value('time since the solve began, s')


@dataclass(frozen=True)
class ApproachStatus:
    """A smallest distance."""

    distance: float = _value('', **{_GROUP: True})
    beyond_margin: float = _value(
        'the distance that is left if every UAV is off by `tracking_margin`, m')
    between: str = _value('which two come so close', '')
    time: float = _value('when they come so close, s from point 0')


@dataclass(frozen=True)
class EnergyStatus:
    """The energy of the flight of a UAV."""

    total: float = _value('', **{_GROUP: True})
    hovering: float = _value('part of the energy of a UAV that it takes to hover, J')
    flying: float = _value('part of the energy of a UAV that it takes to fly, J')


@dataclass(frozen=True)
class PlanStatus:
    """The last plan."""

    identity: str = _value('8 digits that tell the last plan from others', '')
    stamp: float = _value('time of point 0 of the plan, s', form='.9f')
    age: float = _value('time since point 0 of the plan, s; below zero before it')
    promised_until: float | None = _value(
        'where receivers move: until when the rates are promised, s from point 0', None)
    promised_slots: int = _value(
        'number of slots whose rates are promised; rates are means over these slots, `none` '
        'without any', 0)
    guaranteed_rate: float = _value('guaranteed rate of the plan, bit/s/Hz')
    worst_case_rate: float = _value('worst-case rate of the plan, bit/s/Hz')
    node_rate: dict[str, float] = _values(
        'mean rate of a ground node by the objective, bit/s/Hz', 'ground_node')
    curve_rate: float = _value('guaranteed rate along the flown curve, bit/s/Hz')
    bound: float | None = _value(
        'rate that no plan can exceed, bit/s/Hz, with the parameter `bound`', None)
    claim: str | None = _value('the bound in words', None)
    uav_distance: ApproachStatus = _value(
        'smallest distance between any two UAVs, m; below 5 m without a `separation`, the level '
        'is WARN', ApproachStatus())
    zone_distance: ApproachStatus = _value(
        'smallest distance of any UAV from a no-fly zone as given, m', ApproachStatus())
    energy: dict[str, EnergyStatus] = _values(
        'energy of the flight of a UAV by the model of its propulsion, J', 'uav')
    method: str = _value('method that made the plan', '')
    objective: str = _value('rate that the method maximised', '')
    status: str = _value('why the method stopped', '')
    iterations: int = _value('number of iterations that the method took', 0)
    solve_time: float = _value('how long the method took, s')


@dataclass(frozen=True)
class TrackStatus:
    """The flight of a plan; without reports on `plan_time` there is none, and `plan` is empty."""

    plan: str = _value('identity of the plan that is flown, by the reports on `plan_time`; '
                       'without any there is no `track`', '')
    time: float = _value('progress of the flight, s from point 0')
    state: str = _value('`waiting`, `flying`, `held` or `ended`, with `, silent` after a second '
                        'without a report', '')
    distance: dict[str, float] = _values(
        'distance of a UAV from its plan when it was measured, m; `none` without odometry and '
        'poses. Beyond `track_tolerance` the level is WARN', 'uav')
    rate: float = _value('guaranteed rate so far where the UAVs really were, with the planned '
                         'powers, of all ground nodes together, bit/s/Hz')
    planned_rate: float = _value('guaranteed rate so far where the plan had the UAVs, bit/s/Hz')
    measured: float = _value('share of the slots so far in which all UAVs were measured; '
                             '`track.rate` and `track.planned_rate` are means over these slots')


@dataclass(frozen=True)
class PlannerStatus:
    """
    The status of the planner.

    :ivar level: level of a DiagnosticStatus, as bytes.
    :ivar text: problems, and the outcome of the last request or the progress of a solve.
    """

    level: bytes = DiagnosticStatus.OK
    text: str = ''
    state: str = _value('`idle` or `solving`', '')
    outcome: OutcomeStatus = OutcomeStatus()
    plans: int = _value('plans made by request since the start, and the restored one', 0)
    replans: int = _value('plans made in flight by the planner itself', 0)
    refusals: int = _value('requests and replans without a plan', 0)
    progress: ProgressStatus = ProgressStatus()
    plan: PlanStatus = PlanStatus()
    pose_age: dict[str, float] = _values(
        'age of the last pose or odometry on a topic, s; `none` before the first', 'topic')
    relay: dict[str, str] = _values(
        'what becomes of the setpoints of a UAV by its relay: `passing`, `holding` the last '
        'place, `refused`, `disabled`, `silent` (no setpoints come), or `lost` if the relay has '
        'ceased to report; without a relay there is none', 'uav')
    track: TrackStatus = TrackStatus()

    def has_pose(self, topic: str) -> bool:
        """Return True if a pose or odometry has come on a topic."""
        return not math.isnan(self.pose_age.get(topic, math.nan))

    def to_message(self, name: str) -> DiagnosticStatus:
        """Return the message under a name; groups that have not begun are left out."""
        return diagnostic_status(name, self.level, self.text, dict(_list_values(self, '')))

    @classmethod
    def from_message(cls, message: DiagnosticStatus) -> 'PlannerStatus':
        """
        Return the status in a message; keys that it lacks leave the defaults.

        :raises OptionError: for a value that its field does not take.
        """
        tree: _Node = {'level': {None: message.level}, 'text': {None: message.message}}
        for entry in message.values:  # The text of the key 'a.b' is at tree['a']['b'][None].
            node = tree
            for part in entry.key.split('.'):
                node = node.setdefault(part, {})
            node[None] = entry.value
        status: PlannerStatus = _read(cls, tree, '')
        return status


def list_keys(kind: Any = PlannerStatus, prefix: str = '') -> Iterator[tuple[str, str]]:
    """Yield the key of each value of a status, with placeholders as `<uav>`, and its meaning."""
    hints = get_type_hints(kind)
    for entry in fields(kind):
        hint, member = hints[entry.name], entry.metadata.get('member', '')
        key, meaning = f'{prefix}{entry.name}{member}', entry.metadata.get('meaning', '')
        if meaning:
            yield key, meaning
        value_kind = get_args(hint)[1] if member else hint
        if is_dataclass(value_kind):
            yield from list_keys(value_kind, f'{key}.')


def _key(entry: 'Field[Any]', prefix: str) -> str:
    """Return the key of a field of a group whose keys have a prefix."""
    return prefix.rstrip('.') if _GROUP in entry.metadata else prefix + entry.name


def _list_values(group: Any, prefix: str) -> Iterator[tuple[str, object]]:
    """
    Yield the key and the value of each field of a group that the status message carries.

    Left out are None, groups that equal their defaults, and the fields `level` and `text` of the
    whole status, which have no key.
    """
    for entry in fields(group):
        value, key = getattr(group, entry.name), _key(entry, prefix)
        if isinstance(value, dict):
            for name, item in value.items():
                yield from (_list_values(item, f'{key}.{name}.') if is_dataclass(item)
                            else [(f'{key}.{name}', item)])
        elif is_dataclass(value):
            if value != cast(Any, type(value))():
                yield from _list_values(value, f'{key}.')
        elif value is not None and (entry.metadata or prefix):
            form = entry.metadata.get('form')
            yield key, format(value, form) if form else value


def _read(kind: Any, node: _Node, key: str) -> Any:
    """
    Return the value of a type that is read from the keys of a message.

    :param kind: type of the value: a dataclass, whose fields are read from the keys below; a dict
        of names; or a type such as float, for which the text 'none' is NaN.
    :param node: the keys below `key`, each with a node of its own; the text at `key` under None.
    :param key: the key with a final dot, for the error.
    :raises OptionError: for a text that the type does not take.
    """
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        # The text of a field with _GROUP is at the key of the dataclass itself.
        nodes: dict[str, Any] = {
            entry.name: {None: node.get(None)} if _GROUP in entry.metadata
            else node.get(entry.name) for entry in fields(kind)}
        return cast(Any, kind)(**{
            name: _read(hints[name], value, f'{key}{name}.')
            for name, value in nodes.items() if value and value != {None: None}})
    if get_origin(kind) is dict:
        return {name: _read(get_args(kind)[1], value, f'{key}{name}.')
                for name, value in node.items() if name}
    convert, text = next(iter(get_args(kind)), kind), node.get(None)
    try:
        return math.nan if convert is float and text == 'none' else convert(text)
    except (TypeError, ValueError):
        raise OptionError(f'{key[:-1]} of the status is {quote(text)}; it must be of the type '
                          f'{convert.__name__}') from None
