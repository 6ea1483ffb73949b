"""The mission: problems (P1) and (P2) for any team, with its limits and its channel."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
import math
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .consistency import (
    check_accelerations, check_durations, check_ends, check_names, check_sizes, MAX_COUPLINGS,
    POSITION_TOLERANCE)
from .fields import (
    Block, check_items, checked_by, checked_truth, ErrorList, FieldChecks, Members, Number, number,
    Point, raise_all, refuse, REQUIRED, WholeNumber)
from .geography import Origin
from .kinematics import DURATION
from .participants import (
    Boundaries, Eavesdropper, expand_ground_node, GroundNode, MAX_NODES, NoFlyZone, Uav)
from .polygons import checked_polygon, Vertices
from .propagation import Channel, fading_quantiles
from .stored import Stored
from .tracks import LEFT_OUT, ReceiverPlaces, Track
from .validation import Array, checked_array, is_sequence, make_unique, read_only
from ..errors import name_missing_package, prefix_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_MEMBERS = 32
"""Largest number of UAVs, and of eavesdroppers."""

MAX_ZONES = 64
"""Largest number of no-fly zones."""

__all__ = ['Array', 'Channel', 'Eavesdropper', 'GroundNode', 'MAX_COUPLINGS', 'MAX_MEMBERS',
           'MAX_NODES', 'MAX_ZONES', 'NoFlyZone', 'POSITION_TOLERANCE', 'Point', 'Scenario', 'Uav',
           'read_only']


def _checked_head_starts(values: Any) -> tuple[float, ...]:
    if not is_sequence(values):
        raise refuse(values, 'a list of numbers')
    return check_items(values, Number(0.0, 1e12, 'bit/Hz'))


def _stack_field(members: str, field: str, text: str) -> cached_property[Array]:
    """Return a property of Scenario: an array of one field of all `members`; None is infinity."""
    def values(scenario: Any) -> Array:
        fields = [getattr(member, field) for member in getattr(scenario, members)]
        return read_only([math.inf if value is None else value for value in fields])

    values.__doc__ = text
    return cached_property(values)


@dataclass(frozen=True)
class Scenario(Stored):
    """
    A mission: problems (P1) and (P2) of the paper for any number of jammers and eavesdroppers.

    UAV 0 transmits to the ground nodes, every other UAV jams. Point n of a trajectory is at time
    n * duration / slots, n = 0..slots+1; power n holds from point n to point n + 1, n = 1..slots.

    :param ground_node: w_0, position (x, y) in m at altitude zero of a single ground node. Given
        together with one GroundNode in ground_nodes, it moves this node, as `replace` needs.
    :param eavesdroppers: at least one Eavesdropper.
    :param uavs: at least one Uav; names are unique, and all have a max_acceleration or none.
    :param duration: T in s. The flight itself lasts (slots + 1) / slots * T.
    :param slots: N, number of slots.
    :param reference_snr_db: beta_0 / sigma^2, the SNR at 1 m and 1 W, in dB.
    :param separation: smallest three-dimensional distance between any two UAVs at any time in m;
        0 for no limit.
    :param no_fly_zones: up to 64 NoFlyZone.
    :param geofence: vertices of a polygon, each (x, y) in m, that no UAV leaves at any altitude;
        None for no limit.
    :param tracking_margin: largest distance in m of a vehicle from its plan, in any direction. A
        plan keeps zones that are offset outwards and a geofence that is offset inwards by the
        margin, and a separation that is larger by twice the margin.
    :param channel: a Channel; by default free space.
    :param colluding: whether the eavesdroppers combine their signals, so that their SINRs add up.
        Otherwise the leak is the largest rate of any one eavesdropper.
    :param ground_node_track: track of a single ground node, (t, x, y) at 2 to 10000 times. A
        ground_node given as well must be the track's position at point 0.
    :param ground_nodes: 1 to 16 GroundNode instead of ground_node, which share each slot. A
        single node is served in all slots, whatever its weight.
    :param head_starts: delivery in bit/Hz that is added to each of several ground nodes in its
        mean rate, () for none. cut_tail sets it for nodes that were served more before point 0
        than the least served node, relative to their weights.
    :param origin: Origin that says where on Earth (0, 0) is, or None.
    :raises ScenarioError: naming the field, its value and what is allowed.
    :raises InfeasibleMissionError: if the straight line from start to goal takes longer than the
        duration, naming the UAV and its shortest duration. Zones, fence and separation along the
        way are not checked here but by solve.
    """

    eavesdroppers: tuple[Eavesdropper, ...] = field(
        default=REQUIRED, metadata=checked_by(Members(Eavesdropper, 1, MAX_MEMBERS)))
    uavs: tuple[Uav, ...] = field(
        default=REQUIRED, metadata=checked_by(Members(Uav, 1, MAX_MEMBERS)))
    duration: float = field(default=REQUIRED, metadata=checked_by(DURATION))
    slots: int = field(default=REQUIRED, metadata=checked_by(WholeNumber(1, 20000)))
    reference_snr_db: float = field(default=80.0, metadata=number(-200.0, 300.0, 'dB'))
    separation: float = field(default=0.0, metadata=number(0.0, 1e6, 'm'))
    no_fly_zones: tuple[NoFlyZone, ...] = field(
        default=(), metadata=checked_by(Members(NoFlyZone, 0, MAX_ZONES)))
    geofence: Vertices | None = field(default=None, metadata=checked_by(checked_polygon, 'm'))
    tracking_margin: float = field(default=0.0, metadata=number(0.0, 1e6, 'm'))
    channel: Channel = field(default=Channel(), metadata=checked_by(Block(Channel)))
    colluding: bool = field(default=False, metadata=checked_by(checked_truth))
    origin: Origin | None = field(default=None, metadata=checked_by(Block(Origin)))
    ground_nodes: tuple[GroundNode, ...] = field(
        default=LEFT_OUT, metadata=checked_by(Members(GroundNode, 1, MAX_NODES)))
    head_starts: tuple[float, ...] = field(
        default=(), metadata=checked_by(_checked_head_starts, 'bit/Hz'))

    def __init__(
            self, ground_node: Point | None = None,
            eavesdroppers: tuple[Eavesdropper, ...] = REQUIRED, uavs: tuple[Uav, ...] = REQUIRED,
            duration: float = REQUIRED, slots: int = REQUIRED, reference_snr_db: float = 80.0,
            separation: float = 0.0, no_fly_zones: tuple[NoFlyZone, ...] = (),
            geofence: Vertices | None = None, tracking_margin: float = 0.0,
            channel: Channel = Channel(), colluding: bool = False,
            ground_node_track: Track | None = None, origin: Origin | None = None,
            ground_nodes: tuple[GroundNode, ...] = LEFT_OUT, head_starts: tuple[float, ...] = ()
            ) -> None:
        """Check each field, then the fields against each other; raise all errors as one."""
        values = {name: value for name, value in locals().items() if name != 'self'}
        errors = ErrorList()
        for name, value in self._expand(values, errors).items():
            object.__setattr__(self, name, value)
        raise_all([*FieldChecks(Scenario, self, 'Scenario'), *errors])
        raise_all([
            *check_names(self.uavs, self.eavesdroppers, self.ground_nodes),
            *check_sizes(self.uavs, self.slots, self.ground_nodes, self.head_starts),
            *check_accelerations(self.uavs),
            *check_ends(self.uavs, self.slot_duration, self.separation, self.boundaries),
            *check_durations(self.uavs, self.duration, self.slots)])

    @staticmethod
    def _expand(values: Mapping[Any, Any], errors: ErrorList) -> Mapping[Any, Any]:
        return expand_ground_node(values, errors)

    def __getstate__(self) -> dict[str, Any]:
        # Cached arrays are left out: they would be writable in a copy or after a pickle.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def paper(cls, duration: float = 200.0, error_radius: float = 10.0,
              slots: int | None = None) -> 'Scenario':
        """
        Return the scenario of the paper's Section IV.

        :param duration: T in s, at least 1000 m * N / (N + 1) / (10 m/s).
        :param error_radius: epsilon in m.
        :param slots: N; by default the duration in s, rounded, for slots of about one second.
        :raises ScenarioError: as Scenario does.
        """
        start, goal = (100.0, 500.0), (100.0, -500.0)
        if slots is None:
            with prefix_path('duration'):
                slots = max(1, round(DURATION(duration)))
        return cls(
            ground_node=(0.0, 0.0),
            eavesdroppers=(Eavesdropper((200.0, 0.0), error_radius),),
            uavs=(Uav('uav1', start, goal, altitude=100.0, max_speed=10.0),
                  Uav('uav2', start, goal, altitude=110.0, max_speed=10.0)),
            duration=duration, slots=slots)

    @property
    def ground_node(self) -> Point:
        """Position of the first ground node at point 0, (x, y) in m."""
        return self.ground_nodes[0].position

    @property
    def ground_node_track(self) -> Track | None:
        """Track of the first ground node, None if it stands."""
        return self.ground_nodes[0].track

    @property
    def is_plain_node(self) -> bool:
        """Whether there is a single ground node, with default name, weight and trust."""
        return self.ground_nodes == (
            GroundNode(self.ground_node, track=self.ground_node_track),)

    @property
    def slot_duration(self) -> float:
        """Length of a slot, t_s = T / N, in s."""
        return self.duration / self.slots

    @property
    def times(self) -> Array:
        """Time of each point 0..N+1, (N+2,) in s from point 0."""
        return np.arange(self.slots + 2.0) * self.slot_duration

    @cached_property
    def reference_snr(self) -> float:
        """SNR at 1 m and 1 W, beta_0 / sigma^2, linear."""
        return float(10.0 ** (self.reference_snr_db / 10.0))

    @cached_property
    def receiver_advantages(self) -> Array:
        """SNR of each eavesdropper's receiver relative to a ground node's, linear, (E,)."""
        return read_only([10.0 ** (eve.receiver_advantage_db / 10.0)
                          for eve in self.eavesdroppers])

    starts = _stack_field('uavs', 'start', 'Starts, (U, 2) in m; read-only, as all arrays here.')
    goals = _stack_field('uavs', 'goal', 'Goals, (U, 2) in m.')
    altitudes = _stack_field('uavs', 'altitude', 'Flying heights H, (U,) in m.')
    max_speeds = _stack_field('uavs', 'max_speed', 'Largest speeds V, (U,) in m/s.')
    average_powers = _stack_field(
        'uavs', 'average_power', 'Limits P_ave of the mean powers, (U,) in W.')
    peak_powers = _stack_field(
        'uavs', 'peak_power', 'Limits P_peak of the powers of each slot, (U,) in W.')
    max_energies = _stack_field(
        'uavs', 'max_energy', 'Largest energies of flights, (U,) in J; infinite without a limit.')
    max_accelerations = _stack_field(
        'uavs', 'max_acceleration', 'Largest accelerations, (U,) in m/s^2; infinite for None.')

    @cached_property
    def node_weights(self) -> Array:
        """Weights of the ground nodes, (G,); a single node has weight 1, as none competes."""
        weights = [node.weight for node in self.ground_nodes]
        return read_only(weights if len(weights) > 1 else [1.0])

    def receivers_at(self, times: ArrayLike) -> ReceiverPlaces:
        """Return the ReceiverPlaces at times (K,) in s from point 0."""
        times = checked_array('times', times, (None,))
        grounds, discs = (np.stack([receiver.at(times) for receiver in receivers])
                          for receivers in (self.ground_nodes, self.eavesdroppers))
        return ReceiverPlaces(grounds, discs[..., :2], discs[..., 2])

    @cached_property
    def receivers(self) -> ReceiverPlaces:
        """Where the receivers are at the points 1..N, at which slots begin; read-only."""
        return ReceiverPlaces(*map(read_only, self.receivers_at(self.times[1:-1])))

    @cached_property
    def landmarks(self) -> Array:
        """Places of starts, goals, and receivers (at points 1..N if any moves), (K, 2) in m."""
        receivers = self.receivers if self.has_tracks else self.receivers_at([0.0])
        return read_only(np.concatenate([
            self.starts, self.goals, *receivers.ground_nodes, *receivers.centres]))

    @property
    def has_tracks(self) -> bool:
        """Whether any receiver moves."""
        return any(node.track for node in self.ground_nodes) or any(
            eve.track for eve in self.eavesdroppers)

    @cached_property
    def max_step(self) -> Array:
        """Largest displacement from one point to the next, V * t_s, (U,) in m."""
        return read_only(self.max_speeds * self.slot_duration)

    @cached_property
    def eavesdropper_names(self) -> tuple[str, ...]:
        """Names of the eavesdroppers; several with the default name are numbered."""
        return make_unique([eve.name for eve in self.eavesdroppers])

    @cached_property
    def ground_node_names(self) -> tuple[str, ...]:
        """Names of the ground nodes; several with the default name are numbered."""
        return make_unique([node.name for node in self.ground_nodes])

    @cached_property
    def listeners(self) -> tuple[int, ...]:
        """Numbers of the ground nodes that are not trusted; () for a single ground node."""
        return tuple(number for number, node in enumerate(self.ground_nodes)
                     if not node.trusted and len(self.ground_nodes) > 1)

    @cached_property
    def outage_share(self) -> float:
        """
        Outage budget of each link and cause, fading or line of sight: outage / (links * causes).

        By the union bound, the probability that any link is on the wrong side of its quantile is
        at most the outage, whatever the dependence between links. It is 0 without an outage.
        """
        channel = self.channel
        causes = (channel.rician_k_db is not None) + (channel.los is not None)
        # A link to a node that listens both helps and harms, so it has two budgets.
        links = len(self.uavs) * (
            len(self.ground_nodes) + len(self.eavesdroppers) + len(self.listeners))
        return (channel.outage or 0.0) / (links * max(causes, 1))

    @cached_property
    def fading_gains(self) -> tuple[float, float]:
        """Quantiles of the fading's power gain, (of links that help, of links that harm)."""
        return fading_quantiles(self.channel.rician_k_db, self.outage_share)

    @cached_property
    def node_offsets(self) -> Array:
        """Addition of head_starts to the mean rate of each ground node, (G,) in bit/s/Hz."""
        return read_only(np.array(self.head_starts or np.zeros(len(self.ground_nodes)))
                         / self.duration)

    @cached_property
    def zone_names(self) -> tuple[str, ...]:
        """Names of the no-fly zones: equal names are numbered, and an empty one is 'zone 2'."""
        return make_unique([zone.name or f'zone {number}'
                           for number, zone in enumerate(self.no_fly_zones, start=1)])

    @cached_property
    def boundaries(self) -> Boundaries:
        """Zones, fence and separation, offset by the tracking_margin, as Boundaries."""
        return Boundaries(self)

    @cached_property
    def end_velocities(self) -> Array:
        """Velocities at the starts and at the goals, (2, U, 2) in m/s; NaN if any is allowed."""
        free = (math.nan, math.nan)
        return read_only([[uav.start_velocity or free for uav in self.uavs],
                          [uav.goal_velocity or free for uav in self.uavs]])

    @property
    def limits_acceleration(self) -> bool:
        """Whether the UAVs have a max_acceleration; either all UAVs have one or none."""
        return self.uavs[0].max_acceleration is not None

    @property
    def limits_energy(self) -> bool:
        """Whether any UAV has a limit of energy."""
        return any(uav.max_energy is not None for uav in self.uavs)

    def plot(self) -> 'Figure':
        """
        Return a map of the mission: starts, goals, ground node, discs, zones and fence.

        :return: a matplotlib Figure, which notebooks show and whose savefig writes it to a file.
        :raises MissingPackageError: when Matplotlib is not installed.
        """
        with name_missing_package():
            from ..output.picture import draw_scenario
        return draw_scenario(self)
