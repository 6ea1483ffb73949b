"""Names, meanings and ranges of the nodes' parameters, and what is made of their values."""

from collections.abc import Mapping
from typing import Any

from .spec import Spec
from ..autopilots import STACKS
from ..optimize import METHODS
from ..optimize.solve import checked_objective
from ..plan import Objective, OBJECTIVES
from ..polygons import MAX_VERTICES
from ..scenario import LIMITS, MAX_MEMBERS, MAX_ZONES, Scenario, Uav

_PAPER = Scenario.paper()
_OWN = 'default'  # The method's own objective.

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


def uav_from(values: Mapping[str, Any], name: str) -> Uav:
    """Return the Uav that the parameter values describe."""
    fields = {field: values[f'{name}.{field}'] for field in _FIELDS}
    fields['max_acceleration'] = fields['max_acceleration'] or None
    for field in ('start_velocity', 'goal_velocity'):
        fields[field] = fields[field] or None
    return Uav(name, **fields)
