"""
Pause a flight on its path, and resume it.

UAVs with an acceleration limit slow down on the path to rest; then the same plan is resumed, later
by the length of the pause.
"""

import time

from secure_uav_planner import Scenario
from secure_uav_planner.ros.client import node_process, SecurePlanner

LIMITS = [word for name in ('uav1', 'uav2')
          for word in ('-p', f'{name}.max_acceleration:=2.0')]


def main():
    """Pause in flight for two seconds, and print the state of the flight."""
    with node_process('planner', ['-p', 'duration:=120.0', '-p', 'slots:=120', *LIMITS]), \
            node_process('replay', []), SecurePlanner(Scenario.paper(120.0)) as planner:
        def state():
            return planner.status.track.state

        planner.wait_until(planner.knows_poses, 'a planner that knows all poses',
                           planner.send_poses)
        planner.plan()
        print(planner.start())
        planner.wait_until(lambda: state() == 'flying', 'the flight')
        print(planner.pause())
        planner.wait_until(lambda: state() == 'held', 'the rest on the path')
        print(f'held at {planner.status.track.time:.1f} s of the plan')
        time.sleep(2.0)
        print(planner.start())
        planner.wait_until(lambda: state() == 'flying', 'the flight')
        print(f'going on at {planner.status.track.time:.1f} s of the plan')


if __name__ == '__main__':
    main()
