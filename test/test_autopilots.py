"""The forms of a setpoint that autopilots take, against the conventions of REP-103 and of PX4."""

import math
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from secure_uav_planner.errors import OptionError, PoseError
from secure_uav_planner.output.autopilots import (
    aerostack2_setpoint, mavros_setpoint, ned, px4_odometry, px4_setpoint, Setpoint, STACKS,
    yaw_ned)

# The columns are east, north and up in north-east-down.
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
NUMBER = st.floats(-1e6, 1e6)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)
ANGLE = st.floats(-10.0, 10.0)
SETPOINTS = st.builds(Setpoint, st.just('map'), st.integers(0, 2**62), VECTOR, ANGLE,
                      st.none() | VECTOR, st.none() | VECTOR, st.none() | ANGLE)


@given(VECTOR)
def test_vectors_are_turned_to_ned_and_back(vector):
    assert ned(vector) == tuple((NED @ vector).tolist())
    assert ned(ned(vector)) == vector


@given(ANGLE)
def test_a_yaw_points_where_it_pointed(yaw):
    north, east, _ = NED @ [math.cos(yaw), math.sin(yaw), 0.0]
    assert -math.pi <= yaw_ned(yaw) <= math.pi
    assert math.cos(yaw_ned(yaw)) == pytest.approx(north, abs=1e-9)
    assert math.sin(yaw_ned(yaw)) == pytest.approx(east, abs=1e-9)


@given(VECTOR, VECTOR, VECTOR, st.integers(0, 2**32 - 1), st.sampled_from((1, 3)))
def test_what_px4_reports_is_turned_to_east_north_up_and_forward_left_up(
        place, velocity, rates, seed, frame):
    """The columns of a matrix are where the axes of the body point."""
    attitude = Rotation.random(random_state=np.random.default_rng(seed))  # of FRD, in NED
    x, y, z, w = attitude.as_quat()
    fields = px4_odometry(SimpleNamespace(
        pose_frame=1, position=place, q=np.array([w, x, y, z], np.float32),
        velocity_frame=frame, velocity=velocity, angular_velocity=rates))
    pose, twist = fields['pose']['pose'], fields['twist']['twist']
    assert tuple(pose['position'].values()) == tuple((NED @ place).tolist())
    ahead, right, down = attitude.as_matrix().T
    body = Rotation.from_quat([pose['orientation'][axis] for axis in 'xyzw']).as_matrix().T
    np.testing.assert_allclose(body, [NED @ ahead, NED @ -right, NED @ -down], atol=1e-6)
    # The same velocity, whether it came in the frame of the earth or of the body.
    over_ground = velocity if frame == 1 else attitude.apply(velocity)
    np.testing.assert_allclose(tuple(twist['linear'].values()) @ body, NED @ over_ground,
                               atol=2e-6 * max(map(abs, velocity), default=0.0) + 1e-12)
    assert tuple(twist['angular'].values()) == (rates[0], -rates[1], -rates[2])
    assert 'header' not in fields  # Its clock may be another one.


@pytest.mark.parametrize('field, value, reason', [
    ('pose_frame', 2, 'pose_frame is 2'), ('velocity_frame', 0, 'velocity_frame is 0'),
    ('q', (math.nan, 0.0, 0.0, 0.0), 'q has length nan'),
    ('q', (0.0, 0.0, 0.0, 0.0), 'q has length 0; it must be a quaternion of length 1')])
def test_a_report_of_px4_that_says_nothing_is_refused(field, value, reason):
    report = {'pose_frame': 1, 'position': (0.0,) * 3, 'q': (1.0, 0.0, 0.0, 0.0),
              'velocity_frame': 1, 'velocity': (0.0,) * 3, 'angular_velocity': (0.0,) * 3}
    px4_odometry(SimpleNamespace(**report))
    with pytest.raises(PoseError, match=reason):
        px4_odometry(SimpleNamespace(**{**report, field: value}))


@given(SETPOINTS, st.integers(0, 2**62))
def test_px4_gets_every_value_in_ned_and_nan_for_what_is_not_known(setpoint, now_ns):
    fields = px4_setpoint(setpoint, now_ns)
    target, mode = fields['TrajectorySetpoint'], fields['OffboardControlMode']
    assert target['timestamp'] == mode['timestamp'] == now_ns // 1000
    assert mode['position'] is True and target['yaw'] == yaw_ned(setpoint.yaw)
    for name in ('position', 'velocity', 'acceleration'):
        value = getattr(setpoint, name)
        if value is None:
            assert all(map(math.isnan, target[name])) and not mode[name]
        else:
            assert target[name] == tuple((NED @ value).tolist()) and mode[name]
    assert all(map(math.isnan, target['jerk']))
    assert math.isnan(target['yawspeed']) == (setpoint.yaw_rate is None)


def test_a_setpoint_that_turns_left_turns_left_in_px4_too():
    step = 1e-3
    now, soon = (px4_setpoint(
        Setpoint('map', 0, (0.0, 0.0, 5.0), 1.0 + 0.3 * time, yaw_rate=0.3), 0)[
            'TrajectorySetpoint'] for time in (0.0, step))
    assert (soon['yaw'] - now['yaw']) / step == pytest.approx(now['yawspeed'])
    assert now['yawspeed'] < 0  # clockwise is positive, seen from above


@given(SETPOINTS)
def test_mavros_is_told_what_not_to_use(setpoint):
    target = mavros_setpoint(setpoint, 0)['PositionTarget']
    mask = target['type_mask']
    assert target['coordinate_frame'] == 1
    assert not mask & (1 + 2 + 4 + 1024 + 512)  # the position, the yaw, and no force
    for bits, value in ((8 + 16 + 32, setpoint.velocity),
                        (64 + 128 + 256, setpoint.acceleration), (2048, setpoint.yaw_rate)):
        assert mask & bits == (bits if value is None else 0)
    # MAVROS turns it into NED itself.
    assert tuple(target['position'].values()) == setpoint.position
    assert target['yaw'] == setpoint.yaw
    stamp = target['header']['stamp']
    assert stamp['sec'] * 10**9 + stamp['nanosec'] == setpoint.time_ns


@given(SETPOINTS)
def test_aerostack2_gets_whole_setpoints_only(setpoint):
    if setpoint.velocity is None or setpoint.acceleration is None:
        with pytest.raises(OptionError, match='velocity and acceleration only'):
            aerostack2_setpoint(setpoint, 0)
        return
    fields = aerostack2_setpoint(setpoint, 0)['TrajectorySetpoints']
    assert fields['header']['frame_id'] == 'map'
    point, = fields['setpoints']
    assert tuple(point['twist'].values()) == setpoint.velocity
    assert tuple(point['acceleration'].values()) == setpoint.acceleration
    assert point['yaw_angle'] == setpoint.yaw


def test_every_stack_publishes_what_it_makes():
    setpoint = Setpoint('map', 0, (0.0, 0.0, 1.0), 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for stack in STACKS.values():
        assert set(stack.fields(setpoint, 0)) == set(stack.topics)
