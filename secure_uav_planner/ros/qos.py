"""The quality of service of every topic."""

from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)
"""Of subscriptions: matches publishers of every kind; only the latest pose matters."""

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of plans and status: who joins late gets the last one."""

STREAM = QoSProfile(depth=10)
"""Of setpoints."""

OVERRIDABLE = QoSOverridingOptions([
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY])
"""Parameters `qos_overrides.<topic>.<publisher|subscription>.<policy>` change them at start."""
