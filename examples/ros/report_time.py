"""
Tell the planner that a flight stack of your own flies its plan.

The planner counts a plan as flown only while somebody reports on plan_time: which plan, and at
what time of it. This node does so for a stack that flies each plan by its stamps.
"""

from diagnostic_msgs.msg import DiagnosticStatus
import rclpy
from secure_uav_planner.ros.topics import LATCHED
from sensor_msgs.msg import TimeReference


def main():
    """Report on the last plan of a planner until Ctrl-C."""
    rclpy.init()
    node = rclpy.create_node('own_stack')
    reports, plan = node.create_publisher(TimeReference, 'plan_time', 10), {}
    node.create_subscription(DiagnosticStatus, 'planner/status', lambda status: plan.update(
        (pair.key, pair.value) for pair in status.values), LATCHED)

    def report():
        if 'plan.identity' not in plan:
            return
        message = TimeReference(source=f'{plan["plan.identity"]} {node.get_name()}')
        message.header.stamp = node.get_clock().now().to_msg()
        message.time_ref = message.header.stamp  # A late flight has the time that it is at.
        reports.publish(message)
    node.create_timer(0.1, report)
    rclpy.spin(node)


if __name__ == '__main__':
    main()
