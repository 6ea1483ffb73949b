"""The paper's mission, problem (P2), in this package."""

import sys

from secure_uav_planner import Eavesdropper, Scenario, solve, Uav

slots, time_limit = int(sys.argv[1]), float(sys.argv[2])
START, GOAL = (100.0, 500.0), (100.0, -500.0)
mission = Scenario(
    ground_node=(0.0, 0.0), eavesdroppers=(Eavesdropper((200.0, 0.0), error_radius=10.0),),
    uavs=(Uav('uav1', START, GOAL, altitude=100.0, max_speed=10.0),
          Uav('uav2', START, GOAL, altitude=110.0, max_speed=10.0)),
    duration=120.0, slots=slots)
plan = solve(mission, objective='guaranteed', time_limit=time_limit)
positions, powers, status = plan.positions, plan.powers, plan.status
