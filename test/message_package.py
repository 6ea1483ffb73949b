"""
ROS message packages, built from definitions as colcon builds them, with the generators of ROS.

The packages of autopilots' stacks are not on PyPI. What their messages are made of is little, so
a test that needs one makes the real thing: its classes and what sends them over DDS.
"""

from contextlib import redirect_stdout
import importlib
import io
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig

import numpy

# The fields that mavros_msgs, px4_msgs, geographic_msgs and as2_msgs give these messages.
DEFINITIONS = {
    'mavros_msgs': {
        'PositionTarget': 'std_msgs/Header header, uint8 coordinate_frame, '
                          'uint8 FRAME_LOCAL_NED = 1, uint16 type_mask, uint16 IGNORE_VX = 8, '
                          'uint16 IGNORE_VY = 16, uint16 IGNORE_VZ = 32, uint16 IGNORE_AFX = 64, '
                          'uint16 IGNORE_AFY = 128, uint16 IGNORE_AFZ = 256, '
                          'uint16 IGNORE_YAW_RATE = 2048, geometry_msgs/Point position, '
                          'geometry_msgs/Vector3 velocity, '
                          'geometry_msgs/Vector3 acceleration_or_force, float32 yaw, '
                          'float32 yaw_rate'},
    'px4_msgs': {
        'TrajectorySetpoint': 'uint32 MESSAGE_VERSION = 0, uint64 timestamp, '
                              'float32[3] position, float32[3] velocity, '
                              'float32[3] acceleration, float32[3] jerk, float32 yaw, '
                              'float32 yawspeed',
        'OffboardControlMode': 'uint64 timestamp, bool position, bool velocity, '
                               'bool acceleration, bool attitude, bool body_rate, '
                               'bool thrust_and_torque, bool direct_actuator',
        'VehicleOdometry': 'uint32 MESSAGE_VERSION = 0, uint64 timestamp, '
                           'uint64 timestamp_sample, uint8 pose_frame, '
                           'uint8 POSE_FRAME_NED = 1, float32[3] position, float32[4] q, '
                           'uint8 velocity_frame, uint8 VELOCITY_FRAME_NED = 1, '
                           'float32[3] velocity, float32[3] angular_velocity',
        'VehicleLocalPosition': 'uint32 MESSAGE_VERSION = 1, uint64 timestamp, bool xy_valid, '
                                'uint8 xy_reset_counter, '
                                'uint8 z_reset_counter, bool xy_global, uint64 ref_timestamp, '
                                'float64 ref_lat, float64 ref_lon'},
    'geographic_msgs': {
        'GeoPoint': 'float64 latitude, float64 longitude, float64 altitude',
        'GeoPointStamped': 'std_msgs/Header header, geographic_msgs/GeoPoint position'},
    'as2_msgs': {
        'TrajectoryPoint': 'string id, geometry_msgs/Vector3 position, '
                           'geometry_msgs/Vector3 twist, geometry_msgs/Vector3 acceleration, '
                           'float32 yaw_angle',
        'TrajectorySetpoints': 'std_msgs/Header header, as2_msgs/TrajectoryPoint[] setpoints'}}

DEPENDENCIES = ('builtin_interfaces', 'std_msgs', 'geometry_msgs')
NEEDED = ('rosidl_adapter', 'rosidl_generator_c', 'rosidl_generator_py',
          'rosidl_generator_type_description', 'rosidl_typesupport_c',
          'rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c')


def missing():
    """Return what is missing to build a package, or an empty list."""
    header = Path(sysconfig.get_paths()['include'], 'Python.h')
    found = [tool for tool in ('gcc', 'g++') if shutil.which(tool) is None]
    found += [] if header.exists() else [str(header)]
    for name in NEEDED:
        try:
            importlib.import_module(name)
        except ImportError:
            found.append(name)
    if not (Path(sys.prefix) / 'include' / 'rosidl_runtime_c').exists():
        found.append('the headers of ROS in the environment')
    return found


class MessagePackage:
    """
    A message package that is built in a folder.

    :param folder: where to; it belongs into sys.path afterwards.
    :param name: the name of the package.
    :param definitions: the text of each .msg file by the name of its type.
    """

    def __init__(self, folder, name, definitions):
        self._name, self._prefix = name, Path(sys.prefix)
        self._sources = folder / 'sources' / name
        self._other = folder / 'introspection'
        self.folder = folder / name
        (self._sources / 'msg').mkdir(parents=True)
        with redirect_stdout(io.StringIO()):
            self._generate(definitions)
        self._compile()

    def _generate(self, definitions):
        from rosidl_adapter.msg import convert_msg_to_idl
        from rosidl_generator_c.cli import GenerateC
        from rosidl_generator_py.cli import GeneratePython
        from rosidl_generator_type_description.cli import HashTypeDescription
        from rosidl_typesupport_c.cli import GenerateCTypesupport
        from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
        from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport
        files = []
        for kind, text in definitions.items():
            file = self._sources / 'msg' / f'{kind}.msg'
            file.write_text(text)
            convert_msg_to_idl(
                self._sources, self._name, file.relative_to(self._sources), file.parent)
            files.append(f'{self._sources}:msg/{kind}.idl')
        shared = [str(self._prefix / 'share' / name) for name in DEPENDENCIES]
        arguments = self._name, files, shared
        hashes = HashTypeDescription('type_description').generate_type_hashes(
            *arguments, self.folder)
        GenerateC('c').generate(*arguments, self.folder, type_description_files=hashes)
        supports = ['rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c']
        GenerateFastRTPSCTypesupport('fastrtps_c').generate(*arguments, self.folder)
        # Its files have names that others have, too.
        GenerateIntrospectionCTypesupport('introspection_c').generate(
            *arguments, self._other / self._name)
        GenerateCTypesupport('c', typesupport_implementations=supports).generate(
            *arguments, self.folder)
        GeneratePython('py', typesupport_implementations=['rosidl_typesupport_c']).generate(
            *arguments, self.folder)
        (self.folder / '__init__.py').touch()

    def _compile(self):
        """Compile the libraries that rclpy and the middleware look for by their names."""
        detail = self.folder / 'msg' / 'detail'
        of_own = self._library(
            f'lib{self._name}__rosidl_generator_c.so',
            [*detail.glob('*.c'), *(self.folder / 'msg').glob('*.c*')],
            ['rosidl_generator_c', 'rosidl_generator_py'],
            ['rosidl_typesupport_c', 'rosidl_runtime_c'])
        for_dds = self._library(
            f'lib{self._name}__rosidl_typesupport_fastrtps_c.so', detail.glob('*.cpp'),
            ['rosidl_typesupport_fastrtps_c'],
            ['rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_fastrtps_cpp', 'fastcdr', 'rmw'],
            of_own)
        introspection = self._library(
            f'lib{self._name}__rosidl_typesupport_introspection_c.so',
            (self._other / self._name).rglob('*.c'),
            ['rosidl_typesupport_introspection_c'], ['rosidl_typesupport_introspection_c'],
            of_own)
        # Once it is imported, the two are found by their names.
        suffix = sysconfig.get_config_var('EXT_SUFFIX')
        self._library(
            f'{self._name}_s__rosidl_typesupport_c{suffix}', self.folder.glob('*.c'), [],
            ['rosidl_runtime_c'], of_own, for_dds, introspection)

    def _library(self, name, sources, of_dependencies, of_ros, *own):
        """Compile sources and link them with libraries; return the file."""
        headers = [self.folder.parent, self._other, self._prefix / 'include',
                   *(self._prefix / 'include').iterdir(), sysconfig.get_paths()['include'],
                   numpy.get_include()]
        commands, objects = [], []
        for source in sources:
            objects.append(f'{source}.o')
            commands.append(['gcc' if source.suffix == '.c' else 'g++', '-c', '-fPIC', '-w',
                             *(f'-I{folder}' for folder in headers), source, '-o', objects[-1]])
        running = [subprocess.Popen(command) for command in commands]
        for process in running:
            process.wait()
        assert not any(process.returncode for process in running), name
        folder = self._prefix / 'lib'
        libraries = [folder / f'lib{package}__{kind}.so'
                     for package in DEPENDENCIES for kind in of_dependencies]
        libraries += [folder / f'lib{one}.so' for one in of_ros]
        subprocess.run(
            ['g++', '-shared', '-Wl,--no-as-needed', f'-Wl,-soname,{name}', '-o',
             self.folder / name, *objects, *own,
             *(library for library in libraries if library.exists()),
             f'-Wl,-rpath,{folder}:{self.folder}'], check=True)
        return self.folder / name
