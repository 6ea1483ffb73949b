"""The quality of service of every topic."""

from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)
"""For subscriptions to poses: it matches every publisher; only the latest pose matters."""

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For plans and the status: a late subscriber gets the last one."""

STREAM = QoSProfile(depth=10)
"""For setpoints."""

OVERRIDABLE = QoSOverridingOptions([
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY])
"""The parameters `qos_overrides.<topic>.<publisher|subscription>.<policy>` set these at start."""
