"""
Tell the planner that a flight stack of your own flies its plan.

The planner counts a plan as flown only while somebody reports on plan_time: which plan, and at
what time of it. This node does so for a stack that flies each plan by its stamps.
"""

from diagnostic_msgs.msg import DiagnosticStatus
import rclpy
from secure_uav_planner.ros.planner_status import PlannerStatus
from secure_uav_planner.ros.topics import LATCHED
from sensor_msgs.msg import TimeReference


def main():
    """Report on the last plan of a planner until Ctrl-C."""
    rclpy.init()
    node = rclpy.create_node('own_stack')
    reports, statuses = node.create_publisher(TimeReference, 'plan_time', 10), []
    node.create_subscription(DiagnosticStatus, 'planner/status', lambda message: statuses.append(
        PlannerStatus.from_message(message)), LATCHED)

    def report():
        del statuses[:-1]
        if not statuses or not statuses[-1].plan.identity:
            return
        message = TimeReference(source=f'{statuses[-1].plan.identity} {node.get_name()}')
        message.header.stamp = node.get_clock().now().to_msg()
        message.time_ref = message.header.stamp  # A late flight has the time that it is at.
        reports.publish(message)
    node.create_timer(0.1, report)
    rclpy.spin(node)


if __name__ == '__main__':
    main()
