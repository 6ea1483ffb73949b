"""
Plan for an eavesdropper that drives, and again in flight every few seconds.

Its odometry says where it is and how fast. The planner predicts its disc from that until the next
replan takes effect, and the replay continues with each new plan without a jump of its setpoints.
"""

import time

from secure_uav_planner import Scenario
from secure_uav_planner.ros.client import node_process, SecurePlanner

VELOCITY = (0.0, 4.0)  # m/s, of the eavesdropper
MISSION = ['-p', 'duration:=120.0', '-p', 'slots:=120']
REPLANS = ['-p', 'replan_period:=5.0', '-p', 'replan_lead:=3.0', '-p', 'confidence:=0.9999']


def main(seconds=20.0):
    """Fly for some seconds while the eavesdropper drives, and print each new plan."""
    with node_process('planner', [*MISSION, *REPLANS]), node_process('replay', []), \
            SecurePlanner(Scenario.paper(120.0)) as planner:
        began = time.monotonic()

        def observe():
            planner.send_ground_node((0.0, 0.0))
            place = (200.0, -100.0 + VELOCITY[1] * (time.monotonic() - began))
            planner.send_odometry('eavesdropper', place, VELOCITY, deviation=2.0,
                                  velocity_deviation=0.1)  # m and m/s

        planner.wait_until(planner.knows_poses, 'a planner that knows all poses', observe)
        plan = planner.plan()
        print(f'{plan.identity}: worst case {plan.worst_case_rate:.3f} bit/s/Hz')
        planner.start()
        started = time.monotonic()
        while (elapsed := time.monotonic() - started) < seconds:
            observe()
            newest = planner.last_plan
            if newest is not plan and planner.status.plan.identity == newest.identity:
                plan = newest
                print(f'{plan.identity}: replan {planner.status.replans} at {elapsed:.1f} s, '
                      f'guaranteed {planner.status.plan.guaranteed_rate:.4f} bit/s/Hz')
            time.sleep(0.5)
        print(f'achieved so far: {planner.status.track.rate:.4f} bit/s/Hz')


if __name__ == '__main__':
    main()
