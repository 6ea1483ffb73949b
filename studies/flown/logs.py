"""Flights of a plan, as physics or a known error make them, and their logs in every format."""

from dataclasses import dataclass, replace
import math
import struct

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from secure_uav_planner import Plan
from secure_uav_planner.plan.file import make_text

STORE = get_typestore(Stores.ROS2_JAZZY)
GPS_EPOCH, LEAP = 315964800, 18
_TILT = 0.3  # Pitch in rad of the vehicles in bags, which fly tilted.


@dataclass
class Track:
    """Where the UAVs of a plan were; `positions` and `velocities` are (U, K, 3) at times (K,)."""

    plan: Plan
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    powers: np.ndarray

    def add(self, delay=0.0, offset=0.0, jump_at=math.inf, jump=(0.0, 0.0)):
        """
        Return the track `delay` s later, `offset` m to the left of the plan's way, and moved.

        :param jump_at: time in s from which positions are moved by `jump`, (x, y) in m.
        """
        positions = np.stack([[np.interp(self.times - delay, self.times, column)
                               for column in path.T] for path in self.positions])
        headings = self.plan.curve.at(self.times - delay).headings
        positions = positions.swapaxes(1, 2)
        positions[..., :2] += offset * np.stack([-np.sin(headings), np.cos(headings)], axis=-1)
        positions[:, self.times >= jump_at, :2] += jump
        return replace(self, positions=positions)


def fly(plan, delay=0.3, offset=0.8, frequency=10.0, before=5.0, after=5.0):
    """Return the track of UAVs `delay` s behind the plan and `offset` m left of its way."""
    times = np.arange(plan.curve.begin - before, plan.curve.end + after, 1 / frequency)
    motion = plan.curve.at(times)
    heights = np.broadcast_to(plan.scenario.altitudes[:, None, None], (*motion.headings.shape, 1))
    return Track(plan, times, np.concatenate([motion.positions, heights], -1), np.pad(
        motion.velocities, ((0, 0), (0, 0), (0, 1))), find_powers(plan, times)).add(delay, offset)


def find_powers(plan, times):
    """Return the powers of a plan at times (K,) in s from its point 0, (U, K) in W."""
    slots = np.clip(np.floor(times / plan.scenario.slot_duration + 1e-9).astype(int), 0,
                    plan.scenario.slots + 1)
    return np.pad(plan.powers, ((0, 0), (1, 1)))[:, slots]


def from_physics(plan, flight):
    """Return the Track of a Flight of a plan by studies.flown.flight."""
    velocities = np.gradient(flight.places, flight.times, axis=1)
    return Track(plan, flight.times, flight.places, velocities, find_powers(plan, flight.times))


def write_logs(track, folder, origins=None, clock=100.0):
    """
    Write a track as .ulg, .BIN, bag in MCAP and CSV.

    :param origins: by UAV, where the frame of its autopilot begins, (x, y) in m; its start if not
        given.
    :param clock: time of point 0 in s of the autopilots' clocks.
    :return: by format, what read_flight takes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    uavs, start = track.plan.scenario.uavs, track.plan.start_ns * 1e-9
    sources = {'csv': folder / 'flight.csv', 'mcap': folder / 'bag'}
    write_csv(track, sources['csv'], start)
    write_bag(track, sources['mcap'])
    for kind, write in (('ulg', write_ulog), ('BIN', write_dataflash)):
        sources[kind] = {uav.name: folder / f'{uav.name}.{kind}' for uav in uavs}
        for index, uav in enumerate(uavs):
            write(track, index, sources[kind][uav.name],
                  (origins or {}).get(uav.name, uav.start), clock, start)
    return sources


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
               reset_at=math.inf):
    """
    Write the log of PX4, whose frame begins at `origin` of the plan's.

    :param clock: time of point 0 in s of the log's clock.
    :param utc: UTC of point 0 in s, or None without GPS.
    :param reset_at: time in s from point 0 at which the estimator counts a reset of x and y.
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
        stamp, is_reset = round((time + clock) * 1e6), time >= reset_at
        east, north = place[:2] - origin
        add('D', struct.pack('<HQ6f??BQdd', 0, stamp, north, east, -place[2], speed[1], speed[0],
                             0.0, True, True, int(is_reset), 1, latitude, longitude))
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


def write_telemetry(flight, index, path, origin=(0.0, 0.0), clock=100.0, utc=None,
                    reference=None):
    """
    Write a ground station's telemetry log, whose frame begins at `origin` of the plan's.

    With UTC, a companion computer sends its own time, too, without a time since boot.
    """
    from pymavlink.dialects.v20 import ardupilotmega  # Here, since it takes a second.
    mavlink, companion = (ardupilotmega.MAVLink(None, index + 1, part) for part in (1, 191))
    with open(path, 'wb') as file:
        def write(time, message, sender=mavlink):
            stamp = round((time + (utc or 0.0)) * 1e6)
            file.write(struct.pack('>Q', max(stamp, 0)) + message.pack(sender))

        if reference is not None:
            write(flight.times[0], mavlink.gps_global_origin_encode(
                *(round(value * 1e7) for value in reference), 0))
        for time, place, speed in zip(
                flight.times.tolist(), flight.positions[index], flight.velocities[index]):
            boot_ms = round((time + clock) * 1e3)
            if utc is not None:
                write(time, mavlink.system_time_encode(round((time + utc) * 1e6), boot_ms))
                for _ in range(2):
                    write(time, companion.system_time_encode(round((time + utc) * 1e6), 0),
                          companion)
            write(time, mavlink.local_position_ned_encode(
                boot_ms, place[1] - origin[1], place[0] - origin[0], -place[2], speed[1],
                speed[0], 0.0))


def write_bag(flight, path, plans=(), late=0.0):
    """
    Write a bag in MCAP of the topics that messages.md says to record.

    :param plans: (time, Plan) of each plan that is published and in force from a time in s on; by
        default the plan of the flight.
    :param late: time in s by which the plan's time is behind the clock.
    """
    types = STORE.types
    stamp_type, header_type = types['builtin_interfaces/msg/Time'], types['std_msgs/msg/Header']
    start_ns = flight.plan.start_ns or 0
    waiting = [*plans] or [(-math.inf, flight.plan)]

    def stamp(time):
        nanoseconds = start_ns + round(time * 1e9)
        return stamp_type(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        def connect(topic, kind):
            connection = writer.add_connection(topic, kind, typestore=STORE)
            return lambda time, message: writer.write(
                connection, start_ns + round(time * 1e9), STORE.serialize_cdr(message, kind))

        publish = connect('/plan', 'std_msgs/msg/String')
        report = connect('/plan_time', 'sensor_msgs/msg/TimeReference')
        vector, point = (types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Point'))
        sine, cosine = math.sin(_TILT), math.cos(_TILT)
        quaternion = types['geometry_msgs/msg/Quaternion'](
            x=0.0, y=math.sin(_TILT / 2), z=0.0, w=math.cos(_TILT / 2))
        zeros = np.zeros(36)
        topics = [(connect(f'/{uav.name}/odom', 'nav_msgs/msg/Odometry'),
                   connect(f'/{uav.name}/setpoint/power', 'std_msgs/msg/Float64'))
                  for uav in flight.plan.scenario.uavs]
        for number, time in enumerate(flight.times.tolist()):
            header = header_type(stamp=stamp(time), frame_id='map')
            while waiting and waiting[0][0] <= time:
                _, plan = waiting.pop(0)
                publish(time, types['std_msgs/msg/String'](data=make_text(plan, 'map')))
            report(time, types['sensor_msgs/msg/TimeReference'](
                header=header, time_ref=stamp(time - late), source=f'{plan.identity} /replay'))
            for uav, (odometry, power) in enumerate(topics):
                place, (u, v, w) = flight.positions[uav, number], flight.velocities[uav, number]
                # The twist of an odometry is in the vehicle's frame.
                speed = cosine * u - sine * w, v, sine * u + cosine * w
                pose = types['geometry_msgs/msg/Pose'](
                    position=point(*map(float, place)), orientation=quaternion)
                twist = types['geometry_msgs/msg/Twist'](
                    linear=vector(*map(float, speed)), angular=vector(0.0, 0.0, 0.0))
                odometry(time, types['nav_msgs/msg/Odometry'](
                    header=header, child_frame_id='base_link',
                    pose=types['geometry_msgs/msg/PoseWithCovariance'](pose, zeros),
                    twist=types['geometry_msgs/msg/TwistWithCovariance'](twist, zeros)))
                power(time, types['std_msgs/msg/Float64'](float(flight.powers[uav, number])))
