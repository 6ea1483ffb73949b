"""The nodes' parameters: their names, types, meanings and ranges."""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import NameValidationException
from rclpy.validate_topic_name import validate_topic_name

from ..errors import brief, ParameterError, quote
from ..mission.fields import COORDINATE, find_range, RADIUS
from ..mission.participants import Eavesdropper, NoFlyZone, Propulsion, Uav
from ..mission.polygons import MAX_VERTICES
from ..mission.propagation import Channel, ENVIRONMENTS
from ..mission.scenario import MAX_MEMBERS, MAX_ZONES, Scenario
from ..mission.tracks import MAX_SPEED
from ..optimize import METHODS
from ..output.autopilots import STACKS
from ..plan.plan import OBJECTIVES

_PAPER = Scenario.paper()
_MOST_IN_NAME = 100  # ROS allows about 240 in a topic, of which a name is one part.


@dataclass(frozen=True)
class Spec:
    """
    One parameter.

    :param default: the default value; its type is the parameter's type.
    :param limits: the smallest and the largest allowed number, for numbers and lists of numbers.
    :param length: the smallest and the largest allowed length, for lists and strings.
    :param choices: the allowed strings. YAML's `off`, which is false, counts as the string.
    """

    default: Any
    description: str
    limits: tuple[float, float] | None = None
    length: tuple[int, int] | None = None
    choices: tuple[str, ...] | None = None
    read_only: bool = False

    @property
    def allowed(self) -> str:
        """Return the allowed values in words."""
        noun = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a string',
                list: 'a list'}[type(self.default)]
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        if self.length and isinstance(self.default, str):
            noun += f' of at most {self.length[1]} characters'
        elif self.length:
            low, high = self.length
            noun += f' of {low}' if low == high else f' of {low} to {high}'
            noun += (f' names of letters, digits and _, at most {_MOST_IN_NAME} each'
                     if self._is_name_list else ' numbers')
        if self.limits:
            noun += f' from {self.limits[0]:g} to {self.limits[1]:g}'
        return noun

    @property
    def _is_name_list(self) -> bool:
        return isinstance(self.default, list) and self.limits is None

    def convert(self, name: str, value: Any, prefix: str = '') -> Any:
        """Return the value in the parameter's type, or raise a ParameterError with a prefix."""
        try:
            return self._convert(value)
        except (TypeError, ValueError, OverflowError, NameValidationException):
            raise ParameterError(f'{prefix}{brief(name, 100)} is {quote(value)}; it must be '
                                 f'{self.allowed}', (name,)) from None

    def _convert(self, value: Any) -> Any:
        kind = type(self.default)
        if kind is list:
            values = list(value)
            if isinstance(value, (str, bytes)) or not (
                    self.length[0] <= len(values) <= self.length[1]):
                raise ValueError
            return [_check_name(item) for item in values] if self._is_name_list else [
                self._convert_number(item, float) for item in values]
        if kind in (int, float):
            return self._convert_number(value, kind)
        if value is False and 'off' in (self.choices or ()):
            return 'off'
        if not isinstance(value, kind) or self.choices and value not in self.choices or (
                kind is str and self.length and len(value) > self.length[1]):
            raise ValueError
        return value

    def _convert_number(self, value: Any, kind: type) -> float:
        # An integer is accepted as a float, as in `duration: 150` in YAML, and 1e2 as an integer.
        low, high = self.limits
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
                low <= value <= high and value == kind(value)):
            raise ValueError
        return kind(value)

    def descriptor(self) -> ParameterDescriptor:
        """Return the description that `ros2 param describe` shows."""
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


def _check_name(value: Any) -> str:
    """Return a name that can be part of a topic and of a parameter, or raise a ValueError."""
    if not isinstance(value, str) or '/' in value or '~' in value or (
            len(value) > _MOST_IN_NAME):
        raise ValueError
    validate_topic_name(value)
    return value


LONGEST_FRAME = 255
"""The most characters of a frame_id; a path carries it once for every point."""

OWN_OBJECTIVE = 'default'
"""The one that the method maximises by itself."""

NO_LOS = 'none'
NO_OUTAGE = NO_LIMIT = 0.0
NO_FADING = math.inf
PROPULSIONS = ('none', 'rotary_wing')

_COORDINATE = COORDINATE.low, COORDINATE.high


def _range(kind: type[Any], field: str) -> tuple[float, float]:
    """Return the smallest and the largest value of a field of a dataclass."""
    check = find_range(kind, field)
    return check.low, check.high


CHANNEL = {
    'channel.exponent': Spec(2.0, 'Path loss exponent alpha; 2 is free space.',
                             _range(Channel, 'exponent')),
    'channel.los': Spec(NO_LOS, 'Environment that gives the probability of a line of sight; none '
                        'for a line of sight everywhere, or for channel.los_numbers.',
                        choices=(NO_LOS, *ENVIRONMENTS)),
    'channel.los_numbers': Spec(
        [], 'Numbers a, b per degree and extra loss in dB instead of an environment; empty for '
        'none.', (0.0, 100.0), length=(0, 3)),
    'channel.cautious': Spec(False, 'Whether what leaks and what interferes counts at the gain of '
                             'a line of sight, and what helps at the mean gain; ignored with '
                             'channel.outage.'),
    'channel.rician_k_db': Spec(
        NO_FADING, 'Rician factor of the fading in dB, at most 40; inf for none. It counts only '
        'with channel.outage.', (find_range(Channel, 'rician_k_db').low, NO_FADING)),
    'channel.outage': Spec(
        NO_OUTAGE, 'Largest probability with which the secrecy rate of a slot may be lower than '
        'the guaranteed one because of fading or lines of sight; 0 for no fading and mean gains, '
        'otherwise at least 1e-6.', (NO_OUTAGE, find_range(Channel, 'outage').high)),
}
"""Parameters of the channel by name."""

SCENARIO_FIELDS = {
    'duration': 'T, mission duration in s.',
    'slots': 'N, number of slots of the duration.',
    'reference_snr_db': 'beta_0/sigma^2, SNR at 1 m and 1 W, in dB.',
    'colluding': 'Whether the eavesdroppers put together what they hear.',
    'separation': 'Smallest distance in space between any two UAVs at any time in m; 0 for no '
                  'limit.',
    'tracking_margin': 'Largest error of a vehicle on its plan in m, by which zones grow and the '
                       'geofence shrinks for the plan, and a separation grows by twice it.',
}
"""Meanings of the parameters that are fields of Scenario."""


def _spec(owner: Any, field: str, text: str) -> Spec:
    """Return the Spec of a field of a Scenario, Uav or Propulsion with its value as default."""
    default = getattr(owner, field)
    if isinstance(default, tuple):
        shortest = 0 if field.endswith('velocity') else 2
        return Spec(list(default), text, _COORDINATE, length=(shortest, 2))
    if isinstance(default, bool):
        return Spec(default, text)
    low, high = _range(type(owner), field)
    return Spec(NO_LIMIT, text, (NO_LIMIT, high)) if default is None else Spec(
        default, text, (low, high))


_MISSION_FILE = Spec(
    '', 'Mission file (YAML or JSON) that gives the names of UAVs, eavesdroppers and zones, and '
    'what is not set of the mission; empty for none.', read_only=True)
_NAMES = (1, MAX_MEMBERS)
_UAVS = Spec([uav.name for uav in _PAPER.uavs],
             'Names of the UAVs; the first one transmits, the others jam.',
             length=_NAMES, read_only=True)

PLANNER = {
    'mission_file': _MISSION_FILE,
    'uavs': _UAVS,
    'eavesdroppers': Spec(['eavesdropper'], 'Names of the eavesdroppers.', length=_NAMES,
                          read_only=True),
    'frame_id': Spec('map', 'Frame of all poses and paths, z up (REP-103, REP-105).',
                     length=(0, LONGEST_FRAME)),
    **{field: _spec(_PAPER, field, text)
       for field, text in SCENARIO_FIELDS.items()},
    **CHANNEL,
    'no_fly_zones': Spec([], 'Names of the no-fly zones.', length=(0, MAX_ZONES), read_only=True),
    'geofence': Spec([], 'Vertices of a polygon that no UAV leaves in m, one after the other as '
                     '[x1, y1, x2, y2, ...]; empty for none.', _COORDINATE,
                     length=(0, 2 * MAX_VERTICES)),
    'method': Spec(next(iter(METHODS)), 'Optimisation method.', choices=tuple(METHODS)),
    'objective': Spec(
        OWN_OBJECTIVE, 'Rate that is maximised: the lower bound by formula (guaranteed), or the '
        'true worst case over the discs (worst_case), which only the method joint can and '
        'maximises by default.', choices=(OWN_OBJECTIVE, *OBJECTIVES)),
    'deliver': Spec(
        0.0, "Plan the shortest flight that delivers so many bit/Hz by the objective's rate, with "
        'the method joint; duration and slots then say how long a slot is, and for how long '
        'receivers that move are predicted. 0 for a flight of the duration. A replan in flight '
        'keeps the duration.', (0.0, 1e12)),
    'bound': Spec('off', 'Whether to prove, after a plan has been published, how far below the '
                  'best possible it is at most (for at most one jammer in free space); the '
                  'result is part of the status and of plan_file.', choices=('off', 'after')),
    'time_limit': Spec(60.0, 'Deadline of a solve in s, after which the best feasible plan so '
                       'far is published; 0 for none.', (0.0, 86400.0)),
    'confidence': Spec(0.95, 'Probability that an eavesdropper is within the error radius taken '
                       'from its covariance.', (0.01, 0.999999)),
    'pose_timeout': Spec(10.0, 'Age in s beyond which a pose is not used for planning; 0 for no '
                         'limit.', (0.0, 86400.0)),
    'height_tolerance': Spec(2.0, 'Largest distance in m of the ground node and of the '
                             'eavesdroppers from z = 0 of the frame.',
                             (0.0, find_range(Uav, 'altitude').high)),
    'start_delay': Spec(0.0, 'How far ahead of a request on ~/plan in s the new plan starts, from '
                        'where the UAVs will be then; also the deadline of its solve; 0 to start '
                        'from where they are when it has been solved, or in flight after '
                        'replan_lead.', (0.0, 3600.0)),
    'track_tolerance': Spec(5.0, 'Distance in m from its plan beyond which a UAV is reported; '
                            'nearer, it counts as on its plan.', (0.01, 1e7)),
    'plan_file': Spec('', 'File (JSON) that keeps the last plan over a restart; empty for none.',
                      read_only=True),
    'replan_period': Spec(0.0, 'Period in s after which the rest of the mission is planned '
                          'again; 0 for never.', (0.0, 86400.0)),
    'replan_distance': Spec(0.0, 'Plan the rest of the mission again when the ground node or an '
                            'estimate has moved by more than this distance in m, or an error '
                            'radius has changed by more than a tenth of it; 0 for never.',
                            (RADIUS.low, RADIUS.high)),
    'replan_deviation': Spec(0.0, 'Plan the rest of the mission again, from where the UAVs will '
                             'be, when one is farther from its plan than this distance in m; 0 '
                             'for never.', (0.0, 1e7)),
    'prediction_horizon': Spec(0.0, 'For how long in s receivers that move are predicted; later '
                               'they count where they are then, and nothing is promised. With 0, '
                               'to the end of the flight, or with replans until a later one can '
                               'take effect: replan_period + 2 replan_lead + 2 slots.',
                               (0.0, 1e6)),
    'replan_lead': Spec(2.0, 'How far ahead in s a new plan takes effect in flight; also the '
                        'deadline of its solve.', (0.01, 3600.0)),
}
"""Parameters of the planner that do not belong to one UAV or eavesdropper."""

UAV_FIELDS = {
    'start': 'Start (x, y) in m, used until a pose or odometry of the UAV has arrived.',
    'goal': 'Goal (x, y) in m.',
    'altitude': 'Flying height H above the ground node in m; also the z of published '
                'positions.',
    'max_speed': 'Largest speed V in m/s.',
    'average_power': 'Limit of the mean power in W.',
    'peak_power': 'Limit of the power of every slot in W.',
    'max_acceleration': 'Largest acceleration in m/s^2; 0 for no limit, of all UAVs.',
    'start_velocity': 'Velocity (x, y) in m/s at the start, used only with an acceleration limit; '
                      'empty if it is free.',
    'goal_velocity': 'Velocity (x, y) in m/s at the goal, used only with an acceleration limit; '
                     'empty if it is free.',
}
"""Meanings of the parameters of a UAV that are fields of Uav."""

PROPULSION_FIELDS = {
    'blade_power': 'P_0, power of the blade profile while hovering in W.',
    'induced_power': 'P_i, induced power while hovering in W.',
    'tip_speed': 'U_tip, speed of the rotor blades in m/s.',
    'induced_velocity': 'v_0, mean induced velocity of the rotor while hovering in m/s.',
    'fuselage_drag_ratio': 'd_0, drag ratio of the fuselage.',
    'air_density': 'rho, density of the air in kg/m^3.',
    'solidity': 's, solidity of the rotor.',
    'disc_area': 'A, area of the rotor disc in m^2.',
}
"""Meanings of the parameters of a UAV's propulsion that are fields of Propulsion."""


def uav_parameters(name: str, index: int) -> dict[str, Spec]:
    """Return the parameters of one UAV by name; the paper's values are the defaults."""
    uav = _PAPER.uavs[min(index, len(_PAPER.uavs) - 1)]
    return {**{f'{name}.{field}': _spec(uav, field, text)
               for field, text in UAV_FIELDS.items()},
            f'{name}.propulsion.model': Spec(
                PROPULSIONS[0], 'What flying takes; with a model, the status says the energy of '
                'the plan.', choices=PROPULSIONS),
            **{f'{name}.propulsion.{field}': _spec(Propulsion(), field, text)
               for field, text in PROPULSION_FIELDS.items()},
            f'{name}.use_pose': Spec(
                True, 'Whether to plan from the last odometry or pose of the UAV, if one has '
                'arrived, instead of from its start.'),
            f'{name}.origin': Spec(
                [0.0, 0.0, 0.0], 'What is added to the positions (x, y, z) of the odometry and '
                'poses of the UAV in m: the origin of its local frame; zero where the relay, '
                'which adds it, publishes the odometry.', _COORDINATE, length=(3, 3))}


def eavesdropper_parameters(name: str) -> dict[str, Spec]:
    """Return the parameters of one eavesdropper by name."""
    return {
        f'{name}.error_radius': Spec(
            _PAPER.eavesdroppers[0].error_radius,
            'Error radius epsilon in m, used where the covariance of x and y is zero.',
            (RADIUS.low, RADIUS.high)),
        f'{name}.max_speed': Spec(
            0.0, 'How fast it can be in m/s, in any direction: its error radius then grows by so '
            'much each second from the measurement to the prediction_horizon. With 0, it moves as '
            'its odometry says, or stands.', (0.0, MAX_SPEED)),
        f'{name}.receiver_advantage_db': Spec(
            0.0, "By how much in dB the SNR at its receiver is larger than the ground node's "
            'would be at its place: a better antenna or less noise.',
            _range(Eavesdropper, 'receiver_advantage_db'))}


def zone_parameters(name: str) -> dict[str, Spec]:
    """Return the parameters of one no-fly zone by name."""
    return {
        f'{name}.vertices': Spec(
            [], 'Vertices of the polygon in m, one after the other as [x1, y1, x2, y2, ...]. It '
            'need not be convex.', _COORDINATE, length=(6, 2 * MAX_VERTICES)),
        f'{name}.floor': Spec(
            0.0, 'Lowest altitude in m that is forbidden.', _range(NoFlyZone, 'floor')),
        f'{name}.ceiling': Spec(
            NO_LIMIT, 'Highest altitude in m that is forbidden; 0 for no limit.',
            (NO_LIMIT, find_range(Uav, 'altitude').high))}


def planner_member_parameters(values: Mapping[str, Any]) -> dict[str, Spec]:
    """Return the planner's parameters of the UAVs, eavesdroppers and zones that values name."""
    uavs, eavesdroppers, zones = (
        values[kind] for kind in ('uavs', 'eavesdroppers', 'no_fly_zones'))
    names = [*uavs, *eavesdroppers, *zones, 'ground_node']
    if len(set(names)) < len(names):
        raise ParameterError('parameters uavs, eavesdroppers and no_fly_zones give the names '
                             f"{names[:-1]}; they must be unique and not 'ground_node'")
    members = [*(uav_parameters(name, index) for index, name in enumerate(uavs)),
               *map(eavesdropper_parameters, eavesdroppers), *map(zone_parameters, zones)]
    return {name: spec for specs in members for name, spec in specs.items()}


REPLAY = {
    'mission_file': _MISSION_FILE,
    'uavs': _UAVS,
    'plan_file': Spec('', 'Saved plan to replay; empty to replay the plan of the topics.',
                      read_only=True),
    'frame_id': Spec('map', 'Frame of the setpoints of a saved plan.', length=(0, LONGEST_FRAME),
                     read_only=True),
    'rate': Spec(20.0, 'Setpoints per second.', (0.1, 1000.0), read_only=True),
    'speed': Spec(1.0, 'Playback speed; 1 is real time.', (0.001, 10000.0)),
    'loop': Spec(False, 'Start again at the end, as after ~/reset and ~/start.'),
    'autostart': Spec(False, 'Start every flight at its time, without ~/start; not a plan of the '
                      'topics whose time has passed.'),
    'vehicle_odometry': Spec(False, 'Listen to <uav>/odom of real UAVs, and start when each is at '
                             'its start; false to publish <uav>/odom of UAVs that follow the plan '
                             'exactly.', read_only=True),
    'start_tolerance': Spec(5.0, 'Distance in m within which a UAV counts as at its start.',
                            (0.01, 1e7)),
    'ground_node': Spec(list(_PAPER.ground_node), 'Position (x, y) of the ground node in m, for '
                        'the rates of a plan from the topics.', _COORDINATE,
                        length=(2, 2)),
    'reference_snr_db': Spec(_PAPER.reference_snr_db, 'SNR at 1 m and 1 W in dB, for the rates '
                             'of a plan from the topics.', _range(Scenario, 'reference_snr_db')),
    **CHANNEL,
    'true_eavesdropper': Spec([], 'True position (x, y) of the eavesdropper in m; empty if it is '
                              'not known.', _COORDINATE, length=(0, 2)),
}
"""Parameters of the replay node."""

RELAY = {
    'mission_file': _MISSION_FILE,
    'uavs': _UAVS,
    'stack': Spec('mavros', 'Whose messages to publish.', choices=tuple(STACKS), read_only=True),
    'vehicles': Spec([], 'Namespaces of the vehicles, one for each UAV; empty for the names of '
                     'the UAVs.', length=(0, MAX_MEMBERS), read_only=True),
    'frame_id': Spec('map', 'Frame of the plan, and so of the setpoints that are relayed and of '
                     'the odometry that is published.', length=(0, LONGEST_FRAME)),
    'publish_odometry': Spec(True, 'Publish where the vehicles are, as their autopilots report '
                             'it, in the frame of the plan.', read_only=True),
    'setpoint_timeout': Spec(1.0, 'Age in s beyond which a setpoint is not relayed; also the time '
                             'without setpoints after which nothing more is sent.', (0.1, 60.0)),
    'max_jump': Spec(1.0, 'Distance in m by which a setpoint may be farther from the last one '
                     'relayed than <uav>.max_speed allows since then, or its velocity may lead '
                     'farther in 0.25 s; beyond it, the last place is held.', (0.0, 1e7)),
    'start_tolerance': Spec(5.0, 'Largest distance in m of a vehicle, by its odometry, from the '
                            'first setpoint that is relayed to it, and from one after a jump; '
                            'nothing is relayed before that is known. 0 for a vehicle without '
                            'odometry: its first setpoint is not checked.', (0.0, 1e7)),
}
"""Parameters of the relay that do not belong to one UAV."""


def relay_parameters(name: str, index: int) -> dict[str, Spec]:
    """Return the parameters of the relay for one UAV by name."""
    return {
        f'{name}.origin': Spec(
            [0.0, 0.0, 0.0], "Origin (x, y, z) of the vehicle's local frame in the frame of the "
            'plan in m; often where it was switched on.', _COORDINATE, length=(3, 3)),
        f'{name}.max_speed': uav_parameters(name, index)[f'{name}.max_speed'],
        f'{name}.max_acceleration': Spec(
            NO_LIMIT, 'Largest acceleration in m/s^2 that a setpoint may have; 0 for what '
            'max_jump allows: to lead no farther in 0.25 s.',
            (NO_LIMIT, find_range(Uav, 'max_acceleration').high))}


def relay_member_parameters(values: Mapping[str, Any]) -> dict[str, Spec]:
    """Return the relay's parameters of the UAVs that values name."""
    return {name: spec for index, uav in enumerate(values['uavs'])
            for name, spec in relay_parameters(uav, index).items()}
