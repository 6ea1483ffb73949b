"""A ROS environment of the tests' own, set before anything imports rclpy."""

from contextlib import ExitStack
import os
import sys
import tempfile

from domain_coordinator import domain_id
from hypothesis import HealthCheck, Phase, settings

# Kept as long as the tests run; every worker of pytest-xdist gets a domain of its own.
_reserved = ExitStack()
os.environ['ROS_DOMAIN_ID'] = str(_reserved.enter_context(domain_id()))
os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='ros_log_')
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
# Installed from wheels, ROS finds its index in the environment itself.
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

# A failing example is worth more than a small one that took minutes to shrink.
settings.register_profile('quick', deadline=None, phases=[
    Phase.explicit, Phase.reuse, Phase.generate], suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('quick')
