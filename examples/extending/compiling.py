"""Compile a C++ file of this folder against the headers of the kernel."""

from functools import cache
from importlib import import_module
import os
from pathlib import Path
import shlex
import subprocess
import sys
import sysconfig
import tempfile

from secure_uav_planner.model import kernel

try:
    import pybind11
except ModuleNotFoundError:
    sys.exit('this example needs pybind11: pip install -r examples/requirements.txt')


@cache
def compile_module(name):
    """Compile a C++ file into a temporary folder and import the module."""
    folder = tempfile.mkdtemp()
    includes = pybind11.get_include(), sysconfig.get_path('include'), kernel.__path__[0]
    subprocess.run([
        *shlex.split(os.environ.get('CXX', 'c++')), '-std=c++17', '-shared', '-fPIC',
        '-fvisibility=hidden', *(f'-I{include}' for include in includes),
        str(Path(__file__).with_name(f'{name}.cpp')), '-o', f'{folder}/{name}.so'], check=True)
    sys.path.insert(0, folder)
    return import_module(name)
