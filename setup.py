from glob import glob
import os
import runpy
import shutil
import sys
import sysconfig

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

package_name = 'secure_uav_planner'
sources = runpy.run_path(f'{package_name}/model/kernel/sources.py')

kernel = Extension(
    f'_{package_name}_kernel',  # at the top, where no source tree hides it
    [f'{package_name}/{unit}' for unit in sources['list_sources']('*.cpp')],
    depends=[f'{package_name}/{header}' for header in sources['list_sources']('*.hpp')],
    include_dirs=[f'{package_name}/{folder}' for folder in sources['FOLDERS']], language='c++',
    define_macros=[('KERNEL_SOURCES', f'"{sources["find_digest"]()}"')],
    # Python's own flags may have -fwrapv, with which most loops are not vectorised.
    extra_compile_args=['-std=c++17', '-O3', '-fno-math-errno', '-fno-trapping-math',
                        '-fno-wrapv', '-g0', '-fvisibility=hidden', '-pthread'],
    extra_link_args=['-pthread'])


class BuildKernel(build_ext):
    """Build the kernel, or report the missing packages."""

    def build_extensions(self):
        try:
            import pybind11
            from pybind11.setup_helpers import ParallelCompile
            include = pybind11.get_include()
            ParallelCompile().install()  # Compiles on all cores.
        except ImportError:
            include = '/usr/include'  # of the package pybind11-dev
        available = {'build-essential': shutil.which(self.compiler.compiler_cxx[0]),
                     'pybind11-dev': os.path.exists(f'{include}/pybind11/pybind11.h'),
                     'python3-dev': os.path.exists(
                         sysconfig.get_path('include') + '/Python.h')}
        missing = [name for name, is_there in available.items() if not is_there]
        if missing:
            sys.exit(f'{package_name} has a compiled kernel; to build it, install '
                     f'{", ".join(missing)} (Debian\'s names), as rosdep does. '
                     '`pip install .` needs no compiler on the machine.')
        self.compiler.add_include_dir(include)
        super().build_extensions()


# PyPI has wheels of ROS for this machine only.
WITH_ROS = 'sys_platform == "linux" and platform_machine == "x86_64"'
ros = [f'{name}; {WITH_ROS}' for name in (
    'ros-jazzy-rclpy[fastrtps]==7.1.6', 'ros-jazzy-common-interfaces==5.3.6')]
view = ['matplotlib>=3.7', 'mcap>=1.1', 'pandas>=1.5', 'plotly>=5.15']
explore = ['dash>=4.0', 'plotly>=5.15']
logs = ['pymavlink>=2.4', 'pyulog>=1.1', 'rosbags>=0.11']
campaign = [*view, 'distributed>=2024.1', 'joblib>=1.4', 'pyarrow>=14']

setup(
    name=package_name,
    version='0.2.0',
    packages=find_packages(include=[f'{package_name}*']),
    package_data={
        package_name: ['py.typed'],
        f'{package_name}.mission.formats': ['*.yaml', 'examples/*.yaml'],
        f'{package_name}.model.kernel': ['*.cpp', '*.hpp', '*.pyi'],
        f'{package_name}.bound': ['kernel/*.cpp', 'kernel/*.hpp'],
        f'{package_name}.ros': ['*.yaml']},
    cmdclass={'build_ext': BuildKernel},
    ext_modules=[kernel],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/config', glob('config/*')),
        (f'share/{package_name}/launch', glob('launch/*.launch.py')),
        # What `ros2 run` finds. On PATH, the nodes would have too plain names.
        (f'lib/{package_name}', glob('scripts/*')),
    ],
    entry_points={'console_scripts': [f'{package_name} = {package_name}.__main__:main']},
    python_requires='>=3.10',
    install_requires=[
        'setuptools', 'argcomplete>=2.0', 'clarabel>=0.11', 'cvxpy>=1.4', 'numpy>=1.26',
        'pyyaml>=6.0', 'scipy>=1.11', 'shapely>=2.0'],
    # `ros` is for machines without ROS: an installed ROS has these already.
    extras_require={
        'ros': ros, 'view': view, 'explore': explore, 'campaign': campaign, 'logs': logs,
        'all': [*campaign, *explore, *logs, *ros],
        'test': ['pytest']},  # By which colcon chooses it; the rest is in test/requirements.txt.
    zip_safe=False,
    author='secure_uav_planner maintainers',
    author_email='secure-uav-planner@users.noreply.github.com',
    maintainer='secure_uav_planner maintainers',
    maintainer_email='secure-uav-planner@users.noreply.github.com',
    description='Plans trajectories and powers of UAVs so that a transmission stays secret',
    url='https://github.com/secure-uav-planner/secure_uav_planner',
    license='Apache-2.0',
)
