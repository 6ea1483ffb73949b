"""
Setuptools as a build backend, with a C++ compiler where the machine has none.

The compiler is Zig, a wheel on PyPI. `pip install .` gets here; colcon runs setup.py alone.
"""

from glob import glob
from importlib.util import find_spec
import os
import shlex
import shutil
import sys
import sysconfig

from setuptools import build_meta
from setuptools.build_meta import (
    build_sdist, get_requires_for_build_sdist, prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel)

__all__ = ['build_editable', 'build_sdist', 'build_wheel', 'get_requires_for_build_editable',
           'get_requires_for_build_sdist', 'get_requires_for_build_wheel',
           'prepare_metadata_for_build_editable', 'prepare_metadata_for_build_wheel']


def get_requires_for_build_wheel(config_settings=None):
    return build_meta.get_requires_for_build_wheel(config_settings) + _compiler()


def get_requires_for_build_editable(config_settings=None):
    return build_meta.get_requires_for_build_editable(config_settings) + _compiler()


def build_wheel(*arguments, **options):
    _choose_compiler()
    for folder in glob('build/lib*/secure_uav_planner'):
        shutil.rmtree(folder)  # It may hold deleted modules, which the wheel would contain.
    return build_meta.build_wheel(*arguments, **options)


def build_editable(*arguments, **options):
    _choose_compiler()
    return build_meta.build_editable(*arguments, **options)


def _compiler():
    """Return the requirement of a compiler, if there is none."""
    commands = (os.environ.get(name) or sysconfig.get_config_var(name) or 'c++'
                for name in ('CC', 'CXX'))
    is_available = all(shutil.which(shlex.split(command)[0]) for command in commands)
    return [] if is_available else ['ziglang>=0.13']


def _choose_compiler():
    """Let setuptools call Zig where that is the only compiler."""
    if _compiler() and find_spec('ziglang'):
        # For any processor of the architecture, as other compilers do by default.
        command = shlex.join([sys.executable, '-m', 'ziglang', 'c++', '-mcpu=baseline'])
        os.environ.update(CC=command, CXX=command)
