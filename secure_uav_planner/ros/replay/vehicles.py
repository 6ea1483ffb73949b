"""The vehicles that fly the replay's setpoints: where they are, and whether setpoints arrive."""

import math

from nav_msgs.msg import Odometry

from ..messages import nanoseconds
from ..relay_reports import RelayReports
from ...errors import quote
from ...plan.flight import Flight
from ...plan.player import Point3

_FRESH_S = 1.0  # Largest age [s] of odometry that is taken as the present position.


class Vehicles:
    """
    The last odometry of each vehicle; times are in ns of the node's clock.

    :ivar relays: reports of the relays on the setpoints of each UAV.
    """

    def __init__(self) -> None:
        self.relays = RelayReports()
        self._odometry: dict[str, tuple[int, Odometry]] = {}  # Arrival and odometry by UAV.
        self._distances: dict[str, tuple[Odometry, float]] = {}  # Last odometry and its distance.

    def take(self, topic: str, message: Odometry, now_ns: int) -> None:
        """Keep odometry from the topic `<uav>/odom`."""
        self._odometry[topic.partition('/')[0]] = now_ns, message

    def position(self, name: str, frame_id: str, now_ns: int) -> Point3 | str:
        """Return a UAV's position by odometry, (x, y, z) in m, or in words what is missing."""
        received, message = self._odometry.get(name, (0, None))
        if message is None or not 0 <= now_ns - received <= _FRESH_S * 1e9:
            return f'odometry of {name}'
        header, point = message.header, message.pose.pose.position
        age = (now_ns - (nanoseconds(header.stamp) or received)) * 1e-9
        place = (point.x, point.y, point.z)
        if header.frame_id != frame_id:
            return (f'odometry of {name} in frame {quote(frame_id)}, that which comes is in '
                    f'{quote(header.frame_id)}')
        if not all(map(math.isfinite, place)):
            return f'finite odometry of {name}, its position is {quote(place)}'
        if age > _FRESH_S:
            return f'odometry of {name} of now, the stamp of that which comes is {age:.1f} s old'
        return place

    def find_lost(self, flight: Flight, flight_ns: int, frame_id: str, tolerance: float,
                  now_ns: int) -> dict[str, str]:
        """
        Return the names of the UAVs that are not on their plan, each with the reason in words.

        A UAV is off its plan if it is farther from it than `tolerance` and tracking_margin [m]. A
        UAV without fresh odometry in the frame `frame_id` is taken to be on its plan, unless its
        relay reports that it does not pass setpoints on, or has ceased to report.

        :param flight: the flight as it was at the clock's time flight_ns.
        """
        lost, scenario = {}, flight.playback.plan.scenario
        most = max(tolerance, scenario.tracking_margin)
        for index, uav in enumerate(scenario.uavs):
            relay = self.relays.problem(uav.name, is_under_way=True)
            if isinstance(self.position(uav.name, frame_id, now_ns), str):
                if relay:
                    lost[uav.name] = relay
            elif (distance := self._distance(uav.name, index, flight, flight_ns)) > most:
                lost[uav.name] = (f'{uav.name} is {distance:.1f} m from its plan, beyond {most:g} '
                                  f'm{relay and "; "}{relay}')
        return lost

    def _distance(self, name: str, index: int, flight: Flight, flight_ns: int) -> float:
        """Return a UAV's horizontal distance [m] from its plan when its odometry was measured."""
        # Computed once for each message. `flight` is as it was at the clock's time flight_ns.
        received, message = self._odometry[name]
        if name not in self._distances or self._distances[name][0] is not message:
            stamp, point = nanoseconds(message.header.stamp), message.pose.pose.position
            time = flight.time + flight.time_scale * ((stamp or received) - flight_ns) * 1e-9
            x, y = flight.playback.at(time).positions[index].tolist()
            self._distances[name] = message, math.hypot(point.x - x, point.y - y)
        return self._distances[name][1]
