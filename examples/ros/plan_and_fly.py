"""
Plan from live poses, and fly the plan.

The planner starts from the poses of the UAVs, which a localisation publishes; here the example
does. The replay then streams setpoints, 20 times as fast as real time.
"""

from secure_uav_planner import Scenario
from secure_uav_planner.ros.client import node_process, SecurePlanner

POSITIONS = {'uav1': (80.0, 480.0), 'uav2': (130.0, 510.0)}  # m


def main():
    """Plan from POSITIONS, fly, and print the course of it."""
    mission = ['-p', 'duration:=130.0', '-p', 'slots:=130']
    with node_process('planner', mission), \
            node_process('replay', ['-p', 'speed:=20.0']), \
            SecurePlanner(Scenario.paper(130.0)) as planner:
        def localise():
            planner.send_poses()
            for name, position in POSITIONS.items():
                planner.send_pose(name, position)

        planner.wait_until(lambda: planner.knows_poses(*(f'{name}/pose' for name in POSITIONS)),
                           'a planner that knows all poses', localise)
        plan = planner.plan()
        print(f'{plan.identity}: guaranteed {plan.guaranteed_rate:.3f} bit/s/Hz, '
              f'uav1 starts at {plan.positions[0, 0]} m')
        print(planner.start())
        planner.wait_until(lambda: planner.status.track.state == 'ended', 'the end')
        print('the flight has ended')


if __name__ == '__main__':
    main()
