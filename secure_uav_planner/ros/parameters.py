"""Names, meanings and ranges of the nodes' parameters, and the settings made from them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import difflib
import math
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.validate_topic_name import validate_topic_name

from .text import brief
from ..autopilots import STACKS
from ..errors import ParameterError, PlanningError, shown
from ..mission.parameters import OF_ROS
from ..optimize import METHODS
from ..optimize.solve import checked_objective
from ..plan import Objective, OBJECTIVES
from ..polygons import MAX_VERTICES
from ..scenario import LIMITS, MAX_MEMBERS, MAX_ZONES, Scenario, Uav

_PAPER = Scenario.paper()
_OWN = 'default'  # The method's own objective.


@dataclass(frozen=True)
class Spec:
    """
    One parameter.

    :param default: the default value; its type is the parameter's type.
    :param limits: the smallest and the largest allowed number, for numbers and lists of numbers.
    :param length: the smallest and the largest allowed length, for lists.
    :param choices: the allowed strings.
    """

    default: Any
    description: str
    limits: tuple[float, float] | None = None
    length: tuple[int, int] | None = None
    choices: tuple[str, ...] | None = None
    read_only: bool = False

    @property
    def allowed(self) -> str:
        """Return what is allowed, in words."""
        noun = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a string',
                list: 'a list'}[type(self.default)]
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        if self.length:
            low, high = self.length
            noun += f' of {low}' if low == high else f' of {low} to {high}'
            noun += ' names' if self._of_names else ' numbers'
        if self.limits:
            noun += f' from {self.limits[0]:g} to {self.limits[1]:g}'
        return noun

    @property
    def _of_names(self) -> bool:
        return isinstance(self.default, list) and self.limits is None

    def checked(self, name: str, value: Any) -> Any:
        """Return the value in the parameter's type, or raise ParameterError."""
        try:
            return self._converted(value)
        except (TypeError, ValueError, OverflowError, NameValidationException):
            raise ParameterError(
                f'{name} is {shown(value)}; it must be {self.allowed}') from None

    def _converted(self, value: Any) -> Any:
        kind = type(self.default)
        if kind is list:
            values = list(value)
            if isinstance(value, (str, bytes)) or not (
                    self.length[0] <= len(values) <= self.length[1]):
                raise ValueError
            return [_name(one) for one in values] if self._of_names else [
                self._number(one, float) for one in values]
        if kind in (int, float):
            return self._number(value, kind)
        if not isinstance(value, kind) or (self.choices and value not in self.choices):
            raise ValueError
        return value

    def _number(self, value: Any, kind: type) -> float:
        # An integer is accepted as a float, as in `duration: 150` in YAML.
        if isinstance(value, bool) or not isinstance(value, (int, kind)):
            raise ValueError
        if not math.isfinite(value) or not self.limits[0] <= value <= self.limits[1]:
            raise ValueError
        return kind(value)

    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(
            description=self.description, additional_constraints=f'Must be {self.allowed}.',
            read_only=self.read_only,
            # Types are checked by this class, which accepts an integer as a float.
            dynamic_typing=True)
        if self.limits and isinstance(self.default, float):
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=float(self.limits[0]), to_value=float(self.limits[1]))]
        elif self.limits and isinstance(self.default, int):
            descriptor.integer_range = [IntegerRange(
                from_value=int(self.limits[0]), to_value=int(self.limits[1]), step=1)]
        return descriptor


def _name(value: Any) -> str:
    """Return a name that can be part of a topic and of a parameter."""
    if not isinstance(value, str) or '/' in value or '~' in value:
        raise ValueError
    validate_topic_name(value)
    return value


_NAMES = (1, MAX_MEMBERS)
_UAVS = Spec([uav.name for uav in _PAPER.uavs],
             'Names of the UAVs; the first one transmits, the others jam.',
             length=_NAMES, read_only=True)

PLANNER = {
    'uavs': _UAVS,
    'eavesdroppers': Spec(['eavesdropper'], 'Names of the eavesdroppers.', length=_NAMES,
                          read_only=True),
    'frame_id': Spec('map', 'Frame of all poses and paths, z up (REP-103, REP-105).'),
    'duration': Spec(_PAPER.duration, 'T, mission duration in s.', LIMITS['duration']),
    'slots': Spec(_PAPER.slots, 'N, number of slots of the duration.', LIMITS['slots']),
    'reference_snr_db': Spec(_PAPER.reference_snr_db,
                             'beta_0/sigma^2, SNR at 1 m and 1 W, in dB.',
                             LIMITS['reference_snr_db']),
    'separation': Spec(_PAPER.separation, 'Smallest distance in space between any two UAVs at any '
                       'time in m; 0 for no limit.', LIMITS['separation']),
    'no_fly_zones': Spec([], 'Names of the no-fly zones.', length=(0, MAX_ZONES), read_only=True),
    'geofence': Spec([], 'Vertices of a polygon that no UAV leaves in m, one after the other as '
                     '[x1, y1, x2, y2, ...]; empty for none.', LIMITS['coordinate'],
                     length=(0, 2 * MAX_VERTICES)),
    'method': Spec(next(iter(METHODS)), 'Optimisation method.', choices=tuple(METHODS)),
    'objective': Spec(_OWN, 'Rate that is maximised: the lower bound by formula (guaranteed), or '
                      'the true worst case over the discs (worst_case), which only the method '
                      'joint can and maximises by default.', choices=(_OWN, *OBJECTIVES)),
    'bound': Spec('off', 'Whether to prove, after a plan has been published, how far below the '
                  'best possible it is at most; the result is part of the status and of '
                  'plan_file.', choices=('off', 'after')),
    'time_limit': Spec(60.0, 'Deadline of a solve in s, after which the best feasible plan so '
                       'far is published; 0 for none.', (0.0, 86400.0)),
    'confidence': Spec(0.95, 'Probability that an eavesdropper is within the error radius taken '
                       'from its covariance.', (0.01, 0.999999)),
    'pose_timeout': Spec(10.0, 'Age in s beyond which a pose is not used for planning; 0 for no '
                         'limit.', (0.0, 86400.0)),
    'height_tolerance': Spec(2.0, 'Largest distance in m of the ground node and of the '
                             'eavesdroppers from z = 0 of the frame.',
                             (0.0, LIMITS['altitude'][1])),
    'start_delay': Spec(0.0, 'How far ahead of a request on ~/plan in s the new plan starts, from '
                        'where the UAVs will be then; also the deadline of its solve; 0 to start '
                        'from where they are, when it has been solved.', (0.0, 3600.0)),
    'track_tolerance': Spec(5.0, 'Distance in m from its plan beyond which a UAV is reported; '
                            'nearer, it counts as on its plan.', (0.01, 1e7)),
    'plan_file': Spec('', 'File (JSON) that keeps the last plan over a restart; empty for none.',
                      read_only=True),
    'replan_period': Spec(0.0, 'Period in s after which the rest of the mission is planned '
                          'again; 0 for never.', (0.0, 86400.0)),
    'replan_distance': Spec(0.0, 'Plan the rest of the mission again when the ground node or an '
                            'estimate has moved by more than this distance in m, or an error '
                            'radius has changed by more than a tenth of it; 0 for never.',
                            LIMITS['error_radius']),
    'replan_deviation': Spec(0.0, 'Plan the rest of the mission again, from where the UAVs will '
                             'be, when one is farther from its plan than this distance in m; 0 '
                             'for never.', (0.0, 1e7)),
    'replan_lead': Spec(2.0, 'How far ahead in s a new plan of the rest takes effect; also '
                        'the deadline of its solve.', (0.01, 3600.0)),
}
"""Parameters of the planner that do not belong to one UAV or eavesdropper."""

_FIELDS = {
    'start': 'Start (x, y) in m, used until a pose or odometry of the UAV has arrived.',
    'goal': 'Goal (x, y) in m.',
    'altitude': 'Flying height H above the ground node in m; also the z of published '
                'positions.',
    'max_speed': 'Largest speed V in m/s.',
    'average_power': 'Limit of the mean power in W.',
    'peak_power': 'Limit of the power of every slot in W.',
    'max_acceleration': 'Largest acceleration in m/s^2; 0 for no limit.',
    'start_velocity': 'Velocity (x, y) in m/s at the start, used only with an acceleration limit; '
                      'empty if it is free.',
    'goal_velocity': 'Velocity (x, y) in m/s at the goal, used only with an acceleration limit; '
                     'empty if it is free.',
}
NO_LIMIT = 0.0


def uav_parameters(name: str, index: int) -> dict[str, Spec]:
    """Return the parameters of one UAV by name; the paper's values are the defaults."""
    uav = _PAPER.uavs[min(index, len(_PAPER.uavs) - 1)]
    return {**{f'{name}.{field}': _uav_spec(getattr(uav, field), text, field)
               for field, text in _FIELDS.items()},
            f'{name}.use_pose': Spec(
                True, 'Whether to plan from the last odometry or pose of the UAV, if one has '
                'arrived, instead of from its start.')}


def _uav_spec(default: Any, text: str, field: str) -> Spec:
    if isinstance(default, tuple):
        shortest = 0 if field.endswith('velocity') else 2
        return Spec(list(default), text, LIMITS['coordinate'], length=(shortest, 2))
    if default is None:
        return Spec(NO_LIMIT, text, (NO_LIMIT, LIMITS[field][1]))
    return Spec(default, text, LIMITS[field])


def objective_from(values: Mapping[str, Any]) -> Objective:
    """
    Return the objective that the parameter values describe.

    :raises OptionError: if the method cannot maximise it.
    """
    objective = values['objective']
    return checked_objective(values['method'], None if objective == _OWN else objective)


def eavesdropper_parameters(name: str) -> dict[str, Spec]:
    """Return the parameters of one eavesdropper by name."""
    return {
        f'{name}.error_radius': Spec(
            _PAPER.eavesdroppers[0].error_radius,
            'Error radius epsilon in m, used where the covariance of the pose is zero.',
            LIMITS['error_radius']),
        f'{name}.receiver_advantage_db': Spec(
            0.0, "By how much in dB the SNR at its receiver is larger than the ground node's "
            'would be at its place: a better antenna or less noise.',
            LIMITS['receiver_advantage_db'])}


REPLAY = {
    'uavs': _UAVS,
    'plan_file': Spec('', 'Saved plan to replay; empty to replay the plan of the topics.',
                      read_only=True),
    'frame_id': Spec('map', 'Frame of the setpoints of a saved plan.'),
    'picture_file': Spec('', 'PNG file in which every new plan is drawn; empty for none.'),
    'rate': Spec(20.0, 'Setpoints per second.', (0.1, 1000.0), read_only=True),
    'speed': Spec(1.0, 'Playback speed; 1 is real time.', (0.001, 10000.0)),
    'loop': Spec(False, 'Start again at the end.'),
    'autostart': Spec(False, 'Start as soon as there is a plan, without ~/start.'),
    'ground_node': Spec(list(_PAPER.ground_node), 'Position (x, y) of the ground node in m, for '
                        'the rates of a plan from the topics.', LIMITS['coordinate'],
                        length=(2, 2)),
    'reference_snr_db': Spec(_PAPER.reference_snr_db, 'SNR at 1 m and 1 W in dB, for the rates '
                             'of a plan from the topics.', LIMITS['reference_snr_db']),
    'true_eavesdropper': Spec([], 'True position (x, y) of the eavesdropper in m; empty if it is '
                              'not known.', LIMITS['coordinate'], length=(0, 2)),
}
"""Parameters of the replay node."""

RELAY = {
    'uavs': _UAVS,
    'stack': Spec('mavros', 'Whose messages to publish.', choices=tuple(STACKS), read_only=True),
    'vehicles': Spec([], 'Namespaces of the vehicles, one for each UAV; empty for the names of '
                     'the UAVs.', length=(0, MAX_MEMBERS), read_only=True),
    'setpoint_timeout': Spec(1.0, 'Age in s of the last setpoint beyond which the heartbeat that '
                             'a stack needs is no longer sent.', (0.1, 60.0)),
}
"""Parameters of the relay that do not belong to one UAV."""


def relay_parameters(name: str) -> dict[str, Spec]:
    """Return the parameters of the relay for one UAV by name."""
    return {f'{name}.origin': Spec(
        [0.0, 0.0, 0.0], "Origin (x, y, z) of the vehicle's local frame in the frame of the "
        'setpoints in m; often where it was switched on.', LIMITS['coordinate'], length=(3, 3))}


class Parameters:
    """
    The declared parameters of a node; a change is validated as a whole, then applied as a whole.

    :param node: a Node.
    :param specs: a Spec for each parameter name.
    :param check: called with all values by name; it raises a PlanningError for a wrong
        combination.
    :raises ParameterError: for a wrong value at the start; the text names the parameter.
    """

    def __init__(self, node: Node, specs: Mapping[str, Spec],
                 check: Callable[[dict[str, Any]], None] = lambda values: None) -> None:
        self._specs: dict[str, Spec] = {}
        self._check = check
        self._values: dict[str, Any] = {}
        self._node = node
        self.declare(specs)
        check(self._values)
        node.add_on_set_parameters_callback(self._on_set)

    def declare(self, specs: Mapping[str, Spec]) -> None:
        """Declare further parameters."""
        values = {}
        for name, spec in specs.items():
            try:
                self._node.declare_parameter(name, spec.default, spec.descriptor())
            except ParameterException as error:
                raise ParameterError(f'parameter {brief(name, 100)}: {brief(error.args[0])}; it '
                                     f'must be {spec.allowed}') from None
            values[name] = spec.checked(f'parameter {name}', self._node.get_parameter(name).value)
        self._specs.update(specs)
        self._values = {**self._values, **values}

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def snapshot(self) -> dict[str, Any]:
        """Return all present values by name; later changes do not affect them."""
        return self._values

    def apply(self, check: Callable[[dict[str, Any]], None]) -> None:
        """Check all values with another function, now and at every change."""
        check(self._values)
        self._check = check

    def warn_of_unknown(self) -> None:
        """Log every given parameter that does not exist, with the nearest name that does."""
        for name in sorted(_given(self._node)):
            if self._node.has_parameter(name) or name.startswith(OF_ROS):
                continue
            near = difflib.get_close_matches(name[:200], self._specs, 1)
            hint = f'; did you mean {near[0]}?' if near else ''
            self._node.get_logger().warning(
                f'there is no parameter {brief(name, 100)}, it is ignored{hint}')

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        values = dict(self._values)
        try:
            for parameter in parameters:
                if parameter.name in self._specs:
                    values[parameter.name] = self._specs[parameter.name].checked(
                        parameter.name, parameter.value)
            self._check(values)
        except PlanningError as error:
            return SetParametersResult(successful=False, reason=brief(error))
        self._values = values
        return SetParametersResult(successful=True)


def _given(node: Node) -> list[str]:
    """Return the names of all parameters from the command line and parameter files of a node."""
    # rclpy has no public access to them. Without it, misspelt names would go unnoticed.
    return list(getattr(node, '_parameter_overrides', {}))


def uav_from(values: Mapping[str, Any], name: str) -> Uav:
    """Return the Uav that the parameter values describe."""
    fields = {field: values[f'{name}.{field}'] for field in _FIELDS}
    fields['max_acceleration'] = fields['max_acceleration'] or None
    for field in ('start_velocity', 'goal_velocity'):
        fields[field] = fields[field] or None
    return Uav(name, **fields)
