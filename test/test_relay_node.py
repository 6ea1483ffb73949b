"""The relay node in a process of its own, with real messages of the stacks over DDS."""

from importlib import import_module, invalidate_caches
import inspect
import math
import os
import time

import message_package
import numpy as np
import pytest
from rclpy.node import NodeNameNonExistentError
from ros_client import Client, node_process, PATIENCE, wait_for, wait_for_line
from secure_uav_planner.autopilots import STACKS
from secure_uav_planner.ros import messages
from test_security import policy_of, used
from trajectory_msgs.msg import MultiDOFJointTrajectory

# The fields that mavros_msgs, px4_msgs and as2_msgs give these messages.
DEFINITIONS = {
    'mavros_msgs': {'PositionTarget': """
        std_msgs/Header header
        uint8 coordinate_frame
        uint8 FRAME_LOCAL_NED = 1
        uint16 type_mask
        uint16 IGNORE_VX = 8
        uint16 IGNORE_VY = 16
        uint16 IGNORE_VZ = 32
        uint16 IGNORE_AFX = 64
        uint16 IGNORE_AFY = 128
        uint16 IGNORE_AFZ = 256
        uint16 IGNORE_YAW_RATE = 2048
        geometry_msgs/Point position
        geometry_msgs/Vector3 velocity
        geometry_msgs/Vector3 acceleration_or_force
        float32 yaw
        float32 yaw_rate
        """},
    'px4_msgs': {'TrajectorySetpoint': """
        uint32 MESSAGE_VERSION = 0
        uint64 timestamp
        float32[3] position
        float32[3] velocity
        float32[3] acceleration
        float32[3] jerk
        float32 yaw
        float32 yawspeed
        """, 'OffboardControlMode': """
        uint64 timestamp
        bool position
        bool velocity
        bool acceleration
        bool attitude
        bool body_rate
        bool thrust_and_torque
        bool direct_actuator
        """},
    'as2_msgs': {'TrajectoryPoint': """
        string id
        geometry_msgs/Vector3 position
        geometry_msgs/Vector3 twist
        geometry_msgs/Vector3 acceleration
        float32 yaw_angle
        """, 'TrajectorySetpoints': """
        std_msgs/Header header
        as2_msgs/TrajectoryPoint[] setpoints
        """},
}


@pytest.fixture(scope='module')
def packages(tmp_path_factory):
    """Build the message packages; return what imports a class of theirs."""
    missing = message_package.missing()
    if missing:
        pytest.skip(f'message packages cannot be built here without {", ".join(missing)}')
    folder = tmp_path_factory.mktemp('packages')
    for name, kinds in DEFINITIONS.items():
        message_package.MessagePackage(folder, name, {
            kind: inspect.cleandoc(text) + '\n' for kind, text in kinds.items()})
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setenv('PYTHONPATH', os.pathsep.join(filter(None, [
            str(folder), os.environ.get('PYTHONPATH')])))
        invalidate_caches()
        yield lambda package, kind: getattr(import_module(f'{package}.msg'), kind)


@pytest.fixture
def client():
    with Client() as client:
        yield client


class Source:
    """A program that streams the setpoints of a UAV, like the replay."""

    def __init__(self, client, uav, velocity=(3.0, 4.0), acceleration=(0.5, -0.25)):
        self.message = messages.trajectory_setpoint(
            uav, 'map', client.node.get_clock().now().to_msg(),
            ((10.0, 20.0, 30.0), 0.3, velocity, acceleration))
        self._publisher = client.publisher(
            MultiDOFJointTrajectory, f'{uav}/setpoint/trajectory', 10)
        self.sent = 0

    def until(self, condition):
        """Send until a condition holds."""
        def holds():
            self._publisher.publish(self.message)
            self.sent += 1
            time.sleep(0.02)
            return condition()
        return wait_for(holds)


@pytest.mark.parametrize('stack', STACKS)
def test_without_the_message_package_it_says_in_one_line_what_is_missing_and_how_to_get_it(stack):
    with node_process('relay', stack=stack) as process:
        assert process.wait(timeout=PATIENCE) == 1
    assert len(process.lines) == 1, process.lines
    line, = process.lines
    assert line.startswith(f'cannot start: parameter stack is {stack}: its message package '
                           f'{STACKS[stack].package} is missing')
    assert STACKS[stack].source in line


@pytest.mark.parametrize('parameters, reason', [
    ({'stack': 'paparazzi'}, "stack is 'paparazzi'; it must be one of mavros, px4, aerostack2"),
    ({'vehicles': '[drone0]'}, "vehicles is ['drone0']; it must be empty or have a name for each"),
    ({'vehicles': '[a, a]'}, "vehicles is ['a', 'a']; the names must be unique"),
    ({'uav1.origin': '[1.0, 2.0]'}, 'uav1.origin is [1.0, 2.0]; it must be a list of 3 numbers')])
def test_a_wrong_parameter_ends_it_with_the_reason(parameters, reason):
    with node_process('relay', **parameters) as process:
        assert process.wait(timeout=PATIENCE) == 1
    assert reason in ''.join(process.lines)


def test_mavros_gets_position_velocity_acceleration_and_yaw(packages, client):
    kind = packages('mavros_msgs', 'PositionTarget')
    found = client.listen(kind, 'uav2/mavros/setpoint_raw/local', 1000)
    with node_process('relay', stack='mavros', uav2__origin='[1.0, 2.0, 3.0]'):
        source = Source(client, 'uav2')
        source.until(lambda: found)
        target = found[0]
        assert target.header == source.message.header
        assert target.coordinate_frame == kind.FRAME_LOCAL_NED
        assert target.type_mask == kind.IGNORE_YAW_RATE
        assert [getattr(target.position, axis) for axis in 'xyz'] == [9.0, 18.0, 27.0]
        assert (target.velocity.x, target.velocity.y) == (3.0, 4.0)
        assert target.acceleration_or_force.y == -0.25
        assert target.yaw == pytest.approx(0.3)
        # A source that knows positions only.
        source.message.points[0].velocities = []
        source.message.points[0].accelerations = []
        source.until(lambda: found[-1].type_mask != kind.IGNORE_YAW_RATE)
        assert found[-1].type_mask == sum(
            getattr(kind, f'IGNORE_{name}') for name in (
                'VX', 'VY', 'VZ', 'AFX', 'AFY', 'AFZ', 'YAW_RATE'))


def test_px4_gets_ned_and_the_heartbeat_outlives_setpoints_only_for_a_moment(packages, client):
    targets = client.listen(packages('px4_msgs', 'TrajectorySetpoint'),
                            'px4_1/fmu/in/trajectory_setpoint', 1000)
    modes = client.listen(packages('px4_msgs', 'OffboardControlMode'),
                          'px4_1/fmu/in/offboard_control_mode', 1000)
    with node_process('relay', stack='px4', vehicles='[px4_1, px4_2]',
                      setpoint_timeout=3.0) as process:
        source = Source(client, 'uav1')
        assert not modes  # nothing keeps PX4 in a mode that nobody flies in
        source.until(lambda: targets and modes)
        target = targets[0]
        assert target.position.tolist() == [20.0, 10.0, -30.0]
        assert target.velocity.tolist() == [4.0, 3.0, 0.0]
        assert target.acceleration.tolist() == [-0.25, 0.5, 0.0]
        assert np.isnan(target.jerk).all() and math.isnan(target.yawspeed)
        assert target.yaw == pytest.approx(math.pi / 2 - 0.3)
        assert any(mode.timestamp == one.timestamp for mode in modes for one in targets)
        assert modes[0].position and modes[0].velocity and modes[0].acceleration
        assert not modes[0].attitude
        # Setpoints stop; the heartbeat goes on for a while and ends.
        wait_for_line(process, 'no setpoint of uav1 has come for')
        last = max(target.timestamp for target in targets)
        assert sum(mode.timestamp > last for mode in modes) >= 2
        assert len(targets) <= source.sent  # an old setpoint is never sent again
        count = len(modes)
        time.sleep(1.0)
        assert len(modes) <= count + 1
        # It goes on when they do.
        source.until(lambda: len(modes) > count + 3)


def test_aerostack2_gets_one_point_in_the_frame_of_the_setpoint(packages, client):
    found = client.listen(packages('as2_msgs', 'TrajectorySetpoints'),
                          'drone0/motion_reference/trajectory', 1000)
    with node_process('relay', stack='aerostack2', vehicles='[drone0, drone1]'):
        source = Source(client, 'uav1')
        source.until(lambda: found)
        assert found[0].header == source.message.header
        point, = found[0].setpoints
        assert (point.position.x, point.position.y, point.position.z) == (10.0, 20.0, 30.0)
        assert (point.twist.x, point.twist.y) == (3.0, 4.0)
        assert (point.acceleration.x, point.acceleration.y) == (0.5, -0.25)
        assert point.yaw_angle == pytest.approx(0.3)


def test_what_is_no_setpoint_is_not_relayed_and_said_once_in_a_while(packages, client):
    found = client.listen(packages('mavros_msgs', 'PositionTarget'),
                          'uav1/mavros/setpoint_raw/local', 1000)
    with node_process('relay', stack='mavros') as process:
        source = Source(client, 'uav1')
        source.message.points[0].transforms[0].translation.x = math.nan
        source.until(lambda: any('position is' in line for line in process.lines))
        point = source.message.points[0]
        source.message.points = [point, point]
        source.until(lambda: any('it has 2 points; it must have one' in line
                                 for line in process.lines))
        assert not found
        point.transforms[0].translation.x = 1.0
        source.message.points = [point]
        source.until(lambda: found)
        assert sum('is not relayed' in line for line in process.lines) < 20


def test_the_policy_allows_what_the_relay_uses_and_nothing_else(packages, client):
    """The other nodes are in test_security.py; this one needs a stack's messages."""
    with node_process('relay', use_sim_time='true'):
        def is_as_allowed():
            client.node.get_node_names()
            try:
                return used(client, 'relay') == policy_of('relay')
            except NodeNameNonExistentError:
                return False

        wait_for(is_as_allowed, what='a graph as the policy has it')
