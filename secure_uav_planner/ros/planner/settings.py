"""The settings of the planner."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..parameters import read_fields
from ..settings import (
    airspace_from, channel_from, check_references, objective_from, origin_from, read_settings,
    uav_from, VehicleSettings)
from ...errors import ParameterError
from ...mission import Method, Objective
from ...mission.geography import Origin
from ...mission.participants import Uav
from ...mission.scenario import Scenario
from ...mission.tracks import Track


@dataclass(frozen=True)
class UavSettings(VehicleSettings):
    """
    The parameters of a UAV.

    :ivar mission: the Uav that the parameters describe.
    :ivar use_pose: whether a new mission begins where the UAV is measured.
    """

    mission: Uav
    use_pose: bool


@dataclass(frozen=True)
class GroundNodeSettings:
    """The parameters of a ground node, whose place comes from poses or a track."""

    weight: float
    trusted: bool


@dataclass(frozen=True)
class EavesdropperSettings:
    """
    The parameters of an eavesdropper, whose place comes from poses or a track.

    :ivar error_radius: radius of its disc [m] for poses without a covariance.
    """

    error_radius: float
    max_speed: float
    receiver_advantage_db: float


@dataclass(frozen=True)
class PlannerSettings:
    """
    The parameters of the planner by their names, with a mission's parameters as objects.

    :ivar tracks: the track of each receiver that has one in the mission file, by its name.
    :ivar mission: the other fields of Scenario that are parameters, by name.
    """

    uavs: Mapping[str, UavSettings]
    ground_nodes: Mapping[str, GroundNodeSettings]
    eavesdroppers: Mapping[str, EavesdropperSettings]
    tracks: Mapping[str, Track]
    mission: Mapping[str, Any]
    origin: Origin | None
    objective: Objective
    mission_file: str
    service_introspection: str
    frame_id: str
    duration: float
    slots: int
    method: Method
    deliver: float
    bound: str
    time_limit: float
    confidence: float
    pose_timeout: float
    height_tolerance: float
    start_delay: float
    track_tolerance: float
    plan_file: str
    replan_period: float
    replan_distance: float
    replan_deviation: float
    prediction_horizon: float
    replan_lead: float

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> 'PlannerSettings':
        """
        Return the settings for the values of all parameters by name.

        :raises PlanningError: for a wrong combination; it names the parameter.
        """
        objective = objective_from(values)
        if values['deliver'] and values['method'] != 'joint':
            raise ParameterError(f"deliver is {values['deliver']:g}; it is for the method joint, "
                                 f"and method is {values['method']}")
        uavs = {name: read_settings(UavSettings, values, f'{name}.', mission=uav_from(
            values, name)) for name in values['uavs']}
        airspace, channel = airspace_from(values), channel_from(values)
        check_references(values)
        origin = origin_from(values)
        mission = read_fields('planner', Scenario, values) | airspace | {
            'channel': channel, 'origin': origin}
        nodes = {name: read_settings(GroundNodeSettings, values, f'{name}.')
                 for name in values['ground_nodes']}
        eavesdroppers = {name: read_settings(EavesdropperSettings, values, f'{name}.')
                         for name in values['eavesdroppers']}
        return read_settings(
            cls, values, uavs=uavs, ground_nodes=nodes, eavesdroppers=eavesdroppers,
            mission=mission, origin=origin, objective=objective)

    @property
    def receivers(self) -> tuple[str, ...]:
        """Names of the ground nodes and of the eavesdroppers."""
        return (*self.ground_nodes, *self.eavesdroppers)

    @property
    def slot_duration(self) -> float:
        """Length of a slot in s."""
        return self.duration / self.slots

    @property
    def has_replans(self) -> bool:
        """Whether a parameter asks for replans in flight."""
        return any((self.replan_period, self.replan_distance, self.replan_deviation))
