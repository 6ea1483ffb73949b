"""UAVs that a gust pushes aside, flown over DDS in simulated time against the real planner."""

from dataclasses import replace
import math

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
import numpy as np
from ros_client import Client, node_process, PATIENCE, seconds, stamp_at, values_of, wait_for
from secure_uav_planner import Scenario
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.ros import messages
from simulation import DEEP, plan_of, received, Simulation

NAMES = ('uav1', 'uav2')
WIND, GUST = 13.0, (25.0, 35.0)  # m/s towards x, from when to when in s
AIR_SPEED, LEAN = 12.0, 4.0  # m/s and m/s^2, of the autopilots; above those of the plan
STEP = 0.04  # s


class Flight:
    """
    Two point masses that follow the curve of the last plan, as autopilots do.

    The first one has a limit of acceleration, the second one has not.

    :ivar setpoints: time, positions (2, 2) and velocities (2, 2) of each moment.
    :ivar errors: distances from the setpoints, (2,), of each moment.
    """

    def __init__(self, client, scenario, paths, powers):
        self._scenario, self._paths, self._powers = scenario, paths, powers
        self._publishers = [client.node.create_publisher(Odometry, f'{name}/odom', 10)
                            for name in NAMES]
        self._count, self._playback, self._last = 0, None, None
        self.positions, self._velocities = scenario.starts.copy(), np.zeros((2, 2))
        self.setpoints, self.errors, self.plans = [], [], []

    @property
    def time(self):
        """Return the time since point 0 in s, or None before there is a plan."""
        return self.setpoints[-1][0] if self.setpoints else None

    @property
    def is_over(self):
        return self.setpoints and self.time > self._playback.duration + 5.0

    def advance(self, now):
        """Fly on to a time in s."""
        self._load()
        if self._playback is not None:
            begin = self._start + self._playback.begin
            time = max(begin, begin if self._last is None else self._last)
            while time + STEP <= now:
                time += STEP
                self._fly(time - self._start)
                self._last = time
            self._report(self._last or now)

    def _load(self):
        count = min(map(len, self._paths + self._powers))
        if count > self._count:
            stamp = self._paths[0][count - 1].poses[0].header.stamp
            self._start, self._count = seconds(stamp), count
            self.plans.append(plan_of(self._scenario, self._paths, self._powers, count - 1))
            self._playback = Playback(self.plans[-1])

    def _fly(self, time):
        moment = self._playback.at(time)
        offset = moment.positions - self.positions
        wanted = moment.velocities + offset
        wanted *= np.minimum(1.0, AIR_SPEED / np.maximum(
            np.linalg.norm(wanted, axis=1), 1e-9))[:, None]
        change = wanted - self._velocities
        change[0] *= min(1.0, LEAN * STEP / max(np.linalg.norm(change[0]), 1e-9))
        self._velocities += change
        self.positions += self._over_ground(time) * STEP
        self.setpoints.append((time, moment.positions, moment.velocities))
        self.errors.append(np.linalg.norm(offset, axis=1))

    def _over_ground(self, time):
        return self._velocities + [WIND * (GUST[0] <= time < GUST[1]), 0.0]

    def _report(self, now):
        for name, publisher, (x, y), velocity in zip(
                NAMES, self._publishers, self.positions, self._over_ground(now - self._start)):
            publisher.publish(messages.odometry(
                'map', f'{name}/base_link', stamp_at(now), (x, y, 100.0), 0.7, velocity))


def test_uavs_that_are_pushed_aside_are_brought_back_within_the_limits_of_their_setpoints():
    scenario = Scenario.paper(140.0, slots=70)
    limited, free = scenario.uavs
    scenario = replace(scenario, uavs=(replace(limited, max_acceleration=2.0), free))
    with Client() as client, node_process(
            'planner', use_sim_time='true', duration=140.0, slots=70, pose_timeout=0.0,
            replan_deviation=6.0, replan_lead=3.0, uav1__max_acceleration=2.0):
        paths, powers = received(client)
        status = client.listen(DiagnosticStatus, 'planner/status', DEEP)
        flight = Flight(client, scenario, paths, powers)
        with Simulation(client, lambda now: (200.0, 0.0), speedup=8,
                        advance=flight.advance) as simulation:
            client.send_paper(stamp=simulation.stamp())
            assert client.call('planner/plan').success
            wait_for(lambda: flight.is_over, patience=10 * PATIENCE, what='the end')
    times = np.array([time for time, _, _ in flight.setpoints])
    positions, velocities = (np.array([moment[index] for moment in flight.setpoints])
                             for index in (1, 2))
    errors = np.array(flight.errors)
    print(f'{len(flight.plans) - 1} replans, errors of {errors.max(axis=0).round(1)} m at most, '
          f'{errors[times > GUST[1] + 20].max(axis=0).round(2)} m from 20 s after the gust, '
          f'{np.linalg.norm(flight.positions - scenario.goals, axis=1).round(3)} m at the goal')

    # No jump, from the first setpoint to the last: speed, acceleration, and both agree.
    moves = np.linalg.norm(np.diff(positions, axis=0), axis=-1) / STEP
    assert moves.max() <= 10.0 * (1 + 1e-6)
    changes = np.linalg.norm(np.diff(velocities[:, 0], axis=0), axis=-1) / STEP
    assert 1.9 < changes.max() <= 2.0 * (1 + 1e-6)
    middle = (velocities[1:, 0] + velocities[:-1, 0]) / 2
    assert np.abs(np.diff(positions[:, 0], axis=0) / STEP - middle).max() <= 2.0 * STEP

    # The gust pushed them far aside, the plan came to meet them, and they flew it to the end.
    assert len(flight.plans) > 1
    assert errors[(times > GUST[0]) & (times < GUST[1])].max(axis=0).min() > 20.0
    assert errors[times > GUST[1] + 20.0].max() < 1.0
    assert np.linalg.norm(flight.positions - scenario.goals, axis=1).max() < 0.1
    led = np.linalg.norm(positions - np.stack([
        Playback(flight.plans[0]).at(time).positions for time in times]), axis=-1)
    assert led[times < GUST[0]].max() == 0.0
    assert led[times > GUST[1]].max() > 10.0

    # The status said so, and what it cost.
    texts = [message.message for message in status if message.level == DiagnosticStatus.WARN]
    assert any('uav1 is ' in text and 'm from its plan' in text for text in texts)
    last = values_of(status[-1])
    assert float(last['track.rate']) < float(last['track.planned_rate'])
    assert math.isclose(float(last['track.rate']), float(last['plan.guaranteed_rate']),
                        rel_tol=0.1)
    assert int(last['replans']) == len(flight.plans) - 1
