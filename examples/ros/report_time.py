"""
Tell the planner that a flight stack of your own flies its plan.

The planner counts a plan as flown only while somebody reports on plan_time: which plan, and at
what time of it. This node does so for a stack that flies each plan by its stamps.
"""

from diagnostic_msgs.msg import DiagnosticStatus
import rclpy
from secure_uav_planner.ros.planner_status import PlannerStatus, PlanStatus
from secure_uav_planner.ros.topics import LATCHED
from sensor_msgs.msg import TimeReference


def main():
    """Report on the last plan of a planner until Ctrl-C."""
    rclpy.init()
    node = rclpy.create_node('own_stack')
    reports = node.create_publisher(TimeReference, 'plan_time', 10)
    flown = newest = PlanStatus()

    def take(message):
        nonlocal newest
        newest = PlannerStatus.from_message(message).plan

    def report():
        nonlocal flown
        now = node.get_clock().now()
        # A replan has the stamp of the flown plan. Any other new plan is flown from its stamp on.
        if not flown.identity or newest.stamp <= max(flown.stamp, now.nanoseconds * 1e-9):
            flown = newest
        if flown.identity:
            message = TimeReference(source=f'{flown.identity} {node.get_name()}')
            message.header.stamp = now.to_msg()
            message.time_ref = message.header.stamp  # A late flight has the time that it is at.
            reports.publish(message)
    node.create_subscription(DiagnosticStatus, 'planner/status', take, LATCHED)
    node.create_timer(0.1, report)
    rclpy.spin(node)


if __name__ == '__main__':
    main()
