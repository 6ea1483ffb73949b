"""A ROS environment of the tests' own, set before anything imports rclpy; what a test needs."""

from contextlib import ExitStack, suppress
from importlib import import_module, invalidate_caches
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
import os
from pathlib import Path
import re
import runpy
import signal
import sys
import tempfile

from hypothesis import HealthCheck, Phase, settings
import message_package
import pytest
import setuptools

# A shell starts what runs in the background with SIGINT ignored, and that would be handed down to
# the nodes, which the tests stop by it.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Kept as long as the tests run; every worker of pytest-xdist gets a domain of its own.
_reserved = ExitStack()
with suppress(ImportError):  # Without ROS, tests of nodes are skipped.
    from domain_coordinator import domain_id
    os.environ['ROS_DOMAIN_ID'] = str(_reserved.enter_context(domain_id()))
os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='ros_log_')
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
# Installed from wheels, ROS finds its index in the environment itself.
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

# A failing example is worth more than a small one that took minutes to shrink. The short tests
# draw the same examples every time, as they are a gate; the long ones draw new ones.
for _name, _same, _examples in (('quick', True, 40), ('soak', False, 100)):
    settings.register_profile(
        _name, deadline=None, derandomize=_same, max_examples=_examples,
        phases=[Phase.explicit, Phase.reuse, Phase.generate],
        suppress_health_check=[HealthCheck.too_slow])

# Newer versions of Hypothesis also draw constants of the modules loaded so far, which are others
# in every worker: without those, examples are the same indeed.
with suppress(ImportError):
    from hypothesis.internal.conjecture import providers
    providers._get_local_constants = lambda *_: providers._local_constants

# What `rosdep install` does not bring, and which tests need it; without it they are skipped.
# In package.xml is what all others import.
OPTIONAL = {
    'test_bench.py': ['casadi'],
    'test_colcon.py': ['colcon', 'colcon_ros'],
    'test_demo.py': ['mcap', 'plotly'],
    'test_explore.py': ['dash', 'plotly', 'selenium'],
    'test_flown.py': ['matplotlib', 'plotly', 'pymavlink', 'pyulog', 'rosbags'],
    'test_flown_bag.py': ['rosbags'],
    'test_fly.py': ['rclpy', 'rotorpy'],
    'test_measured.py': ['casadi'],
    'test_page.py': ['plotly', 'selenium'],
    'test_parsers.py': ['pymavlink', 'pyulog'],
    'test_relay.py': message_package.NEEDED,
    'test_relay_frames.py': message_package.NEEDED,
    'test_cli.py': ['plotly'],
    'test_new_and_check.py': ['plotly'],
    'test_promise.py': ['plotly'],
    'test_recording.py': ['mcap', 'mcap_ros2', 'rosbags'],
    'test_site.py': ['furo', 'latex2mathml', 'myst_parser', 'sphinx'],
    'test_types.py': ['mypy'],
}


def is_there(module):
    """Return whether a module can be imported, without doing it."""
    try:
        return find_spec(module) is not None
    except ImportError:
        return False


def needs_ros(path):
    """Return whether a module of the tests, or one that it imports, imports ROS."""
    modules = re.findall(r'^(?:from|import) ([.\w]+)', path.read_text(), re.MULTILINE)
    return any(
        re.match(r'rclpy|secure_uav_planner\.ros|\w+_msgs\b', module)
        or ((local := path.with_name(f'{module}.py')).exists() and needs_ros(local))
        for module in modules)


def pytest_configure(config):
    """Choose how examples are drawn, before the tests are read."""
    settings.load_profile('soak' if config.option.markexpr == 'soak' else 'quick')


def pytest_report_header():
    """Say what the tests run with."""
    found = []
    for name in ('numpy', 'scipy', 'cvxpy', 'clarabel', 'shapely'):
        try:
            found.append(f'{name} {version(name)}')
        except PackageNotFoundError:
            found.append(f'no {name}')
    return ', '.join(found)


class Skipped(pytest.Module):
    """A file of tests that is skipped for want of a module."""

    missing = ()

    def collect(self):
        """Skip all of it, with the reason."""
        pytest.skip(f'needs {", ".join(self.missing)} from PyPI', allow_module_level=True)


def pytest_pycollect_makemodule(module_path, parent):
    """Skip a file that needs what is not installed."""
    needed = [*OPTIONAL.get(module_path.name, ()), *['rclpy'] * needs_ros(module_path)]
    missing = [name for name in needed if not is_there(name)]
    if not missing:
        return None
    module = Skipped.from_parent(parent, path=module_path)
    module.missing = missing
    return module


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport():
    """Add to the report of a test that failed what its nodes printed."""
    report = (yield).get_result()
    nodes = sys.modules.get('ros_nodes')
    if report.failed and nodes is not None and (text := nodes.outputs()):
        report.sections.append(('Output of the nodes', text))


@pytest.fixture
def client():
    """Return a client of the nodes."""
    pytest.importorskip('rclpy')
    with import_module('ros_client').Client() as made:  # Imported in the environment from above.
        yield made


@pytest.fixture
def command(capsys):
    """Return a function that runs the command; it returns what is printed on out and err."""
    main = import_module('secure_uav_planner.apps.cli').main

    def run(*words, status=0):
        capsys.readouterr()
        ended, printed = main([*map(str, words)]), capsys.readouterr()
        assert ended == status, printed
        return printed
    return run


@pytest.fixture
def planner():
    """Return a planner of the paper's mission in few slots, for quick solves."""
    pytest.importorskip('rclpy')
    with import_module('ros_nodes').node_here('planner', duration=120.0, slots=40) as planner:
        yield planner


@pytest.fixture(scope='session')
def package_folder(tmp_path_factory):
    """Build the message packages of autopilots' stacks; return their folder."""
    missing = message_package.missing()
    if missing:
        pytest.skip(f'message packages cannot be built here without {", ".join(missing)}')
    folder = tmp_path_factory.mktemp('packages')
    for name, kinds in message_package.DEFINITIONS.items():
        message_package.MessagePackage(folder, name, {
            kind: text.replace(', ', '\n') + '\n' for kind, text in kinds.items()})
    return str(folder)


@pytest.fixture(scope='module')
def packages(package_folder):
    """Return what imports a class of the message packages, which new processes find, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(package_folder)
        patch.setenv('PYTHONPATH', os.pathsep.join(filter(None, [
            package_folder, os.environ.get('PYTHONPATH')])))
        invalidate_caches()
        yield lambda package, kind: getattr(import_module(f'{package}.msg'), kind)


@pytest.fixture(scope='session')
def packaging():
    """Return what setup.py says."""
    said, before, real = {}, os.getcwd(), setuptools.setup
    setuptools.setup = lambda **arguments: said.update(arguments)
    try:
        os.chdir(Path(__file__).resolve().parents[1])
        runpy.run_path('setup.py')
    finally:
        setuptools.setup = real
        os.chdir(before)
    return said
