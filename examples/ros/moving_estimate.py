"""
Plan again in flight whenever the estimate of the eavesdropper has moved.

With `replan_distance` the planner plans the rest of the mission again, and the replay continues
with the new plan without a jump of its setpoints.
"""

import time

from secure_uav_planner import Scenario
from secure_uav_planner.ros.client import node_process, SecurePlanner

SPEED = 4.0  # m/s, of the eavesdropper along y
MISSION = ['-p', 'duration:=120.0', '-p', 'slots:=120']
REPLANS = ['-p', 'replan_distance:=10.0', '-p', 'replan_lead:=3.0']


def main(seconds=20.0):
    """Fly for some seconds while the estimate moves, and print each new plan."""
    with node_process('planner', [*MISSION, *REPLANS]), node_process('replay', []), \
            SecurePlanner(Scenario.paper(120.0)) as planner:
        planner.wait_until(planner.knows_poses, 'a planner that knows all poses',
                           planner.send_poses)
        plan = planner.plan()
        print(f'{plan.identity}: worst case {plan.worst_case_rate:.3f} bit/s/Hz')
        planner.start()
        started = time.monotonic()
        while (elapsed := time.monotonic() - started) < seconds:
            planner.send_ground_node((0.0, 0.0))
            planner.send_estimate('eavesdropper', (200.0, SPEED * elapsed))
            if planner.last_plan is not plan:
                plan = planner.last_plan
                print(f'{plan.identity}: replan {planner.status["replans"]} at {elapsed:.1f} s, '
                      f'guaranteed {planner.status["plan.guaranteed_rate"]} bit/s/Hz')
            time.sleep(0.5)
        print(f'achieved so far: {planner.status["track.rate"]} bit/s/Hz')


if __name__ == '__main__':
    main()
