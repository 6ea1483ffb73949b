"""Flights of a plan that err in a known way, as logs of every format."""

from dataclasses import dataclass
import struct

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
GPS_EPOCH, LEAP = 315964800, 18


@dataclass
class Flight:
    """A plan flown late, beside its way; `positions` and `velocities` are (U, K, 3) at times."""

    plan: object
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    powers: np.ndarray


def fly(plan, delay=0.3, offset=0.8, frequency=10.0, before=5.0, after=5.0):
    """Return a flight whose UAVs are `delay` s behind the plan and `offset` m left of its way."""
    times = np.arange(plan.curve.begin - before, plan.curve.end + after, 1 / frequency)
    motion = plan.curve.at(times - delay)
    left = np.stack([-np.sin(motion.headings), np.cos(motion.headings)], axis=-1)
    heights = np.broadcast_to(plan.scenario.altitudes[:, None, None], (*motion.headings.shape, 1))
    slots = np.clip(np.floor(times / plan.scenario.slot_duration).astype(int), 0,
                    plan.scenario.slots + 1)
    powers = np.pad(plan.powers, ((0, 0), (1, 1)))[:, slots]
    return Flight(plan, times, np.concatenate([motion.positions + offset * left, heights], -1),
                  np.pad(motion.velocities, ((0, 0), (0, 0), (0, 1))), powers)


def write_csv(flight, path, epoch=0.0):
    """Write all UAVs with their powers."""
    lines = ['time,uav,x,y,z,vx,vy,power']
    for uav, track, speeds, powers in zip(
            flight.plan.scenario.uavs, flight.positions, flight.velocities, flight.powers):
        lines += [','.join(map(repr, (float(time) + epoch, uav.name, *place.tolist(),
                                      *speed[:2].tolist(), float(power)))).replace("'", '')
                  for time, place, speed, power in zip(flight.times, track, speeds, powers)]
    path.write_text('\n'.join(lines) + '\n')


def write_tum(flight, index, path):
    """Write a UAV's positions."""
    path.write_text(''.join(
        f'{time!r} {x!r} {y!r} {z!r} 0 0 0 1\n' for time, (x, y, z) in zip(
            flight.times.tolist(), flight.positions[index].tolist())))


def write_ulog(flight, index, path, origin=(0.0, 0.0), clock=100.0, utc=None, reference=None,
               jump_at=None, jump=(0.0, 0.0)):
    """
    Write the log of PX4, whose frame begins at `origin` of the plan's.

    :param clock: time of point 0 in s of the log's clock.
    :param utc: UTC of point 0 in s, or None without GPS.
    :param jump_at: time in s from point 0 of a jump of the frame, by `jump` to east and north.
    """
    formats = {
        'vehicle_local_position': 'uint64_t timestamp;float x;float y;float z;float vx;float vy;'
        'float vz;bool xy_valid;bool z_valid;uint8_t xy_reset_counter;uint64_t ref_timestamp;'
        'double ref_lat;double ref_lon',
        'vehicle_gps_position': 'uint64_t timestamp;uint64_t time_utc_usec',
        'vehicle_status': 'uint64_t timestamp;uint8_t nav_state'}
    parts = [b'ULog\x01\x12\x35\x01' + struct.pack('<Q', 0)]

    def add(kind, data):
        parts.append(struct.pack('<HB', len(data), ord(kind)) + data)

    add('B', bytes(40))
    for name, fields in formats.items():
        add('F', f'{name}:{fields};'.encode())
    for number, name in enumerate(formats):
        add('A', struct.pack('<BH', 0, number) + name.encode())
    latitude, longitude = reference or (np.nan, np.nan)
    for time, place, speed in zip(
            flight.times, flight.positions[index], flight.velocities[index]):
        stamp, has_jumped = round((time + clock) * 1e6), jump_at is not None and time >= jump_at
        east, north = place[:2] - origin + (np.array(jump) if has_jumped else 0.0)
        add('D', struct.pack('<HQ6f??BQdd', 0, stamp, north, east, -place[2], speed[1], speed[0],
                             0.0, True, True, int(has_jumped), 1, latitude, longitude))
        if utc is not None:
            add('D', struct.pack('<HQQ', 1, stamp, round((time + utc) * 1e6)))
        add('D', struct.pack('<HQB', 2, stamp, 14))
    path.write_bytes(b''.join(parts))


def write_dataflash(flight, index, path, origin=(0.0, 0.0), clock=100.0, utc=None,
                    reference=None):
    """Write the log of ArduPilot, whose frame begins at `origin` of the plan's."""
    kinds = {'FMT': (128, 'BBnNZ', 'Type,Length,Name,Format,Columns', '<BB4s16s64s'),
             'XKF1': (129, 'QBffffff', 'TimeUS,C,VN,VE,VD,PN,PE,PD', '<QB6f'),
             'ORGN': (130, 'QBLLe', 'TimeUS,Type,Lat,Lng,Alt', '<QBiii'),
             'GPS': (131, 'QBIH', 'TimeUS,Status,GMS,GWk', '<QBIH'),
             'BAT': (132, 'QBf', 'TimeUS,Inst,EnrgTot', '<QBf')}
    parts = []

    def add(name, *values):
        number, _, _, layout = kinds[name]
        parts.append(b'\xa3\x95' + bytes([number]) + struct.pack(layout, *values))

    for name, (number, types, columns, layout) in kinds.items():
        add('FMT', number, struct.calcsize(layout) + 3, name.encode(), types.encode(),
            columns.encode())
    first = round((flight.times[0] + clock) * 1e6)
    if reference is not None:
        add('ORGN', first, 0, *(round(value * 1e7) for value in reference), 0)
    for number, (time, place, speed) in enumerate(zip(
            flight.times, flight.positions[index], flight.velocities[index])):
        stamp = round((time + clock) * 1e6)
        add('XKF1', stamp, 0, speed[1], speed[0], 0.0, place[1] - origin[1],
            place[0] - origin[0], -place[2])
        add('BAT', stamp, 0, 0.01 * number)
        if utc is not None and number % 10 == 0:
            since = time + utc + LEAP - GPS_EPOCH
            add('GPS', stamp, 3, round(since % 604800 * 1e3), int(since // 604800))
    path.write_bytes(b''.join(parts))


def write_bag(flight, path, plan_text=None):
    """Write a bag in MCAP of the topics that messages.md says to record."""
    types = STORE.types
    stamp_type, header_type = types['builtin_interfaces/msg/Time'], types['std_msgs/msg/Header']
    plan = flight.plan
    start_ns = plan.start_ns or 0

    def stamp(time):
        nanoseconds = start_ns + round(time * 1e9)
        return stamp_type(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        def connect(topic, kind):
            connection = writer.add_connection(topic, kind, typestore=STORE)
            return lambda time, message: writer.write(
                connection, start_ns + round(time * 1e9), STORE.serialize_cdr(message, kind))

        if plan_text is not None:
            connect('/plan', 'std_msgs/msg/String')(
                float(flight.times[0]), types['std_msgs/msg/String'](data=plan_text))
        report = connect('/plan_time', 'sensor_msgs/msg/TimeReference')
        vector, point = (types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Point'))
        quaternion = types['geometry_msgs/msg/Quaternion'](x=0.0, y=0.0, z=0.0, w=1.0)
        zeros = np.zeros(36)
        topics = [(connect(f'/{uav.name}/odom', 'nav_msgs/msg/Odometry'),
                   connect(f'/{uav.name}/setpoint/power', 'std_msgs/msg/Float64'))
                  for uav in plan.scenario.uavs]
        for number, time in enumerate(flight.times.tolist()):
            header = header_type(stamp=stamp(time), frame_id='map')
            report(time, types['sensor_msgs/msg/TimeReference'](
                header=header, time_ref=stamp(time), source=f'{plan.identity} /replay'))
            for uav, (odometry, power) in enumerate(topics):
                place, speed = flight.positions[uav, number], flight.velocities[uav, number]
                pose = types['geometry_msgs/msg/Pose'](
                    position=point(*map(float, place)), orientation=quaternion)
                twist = types['geometry_msgs/msg/Twist'](
                    linear=vector(*map(float, speed)), angular=vector(0.0, 0.0, 0.0))
                odometry(time, types['nav_msgs/msg/Odometry'](
                    header=header, child_frame_id='base_link',
                    pose=types['geometry_msgs/msg/PoseWithCovariance'](pose, zeros),
                    twist=types['geometry_msgs/msg/TwistWithCovariance'](twist, zeros)))
                power(time, types['std_msgs/msg/Float64'](float(flight.powers[uav, number])))
