"""
The demo: plan a mission with both nodes, replay it, save it and draw it.

The planner and the replay node run in separate processes. This third process uses their topics
and services over DDS, like any other program.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
import pathlib
import sys

from examples.isolation import isolated
import numpy as np
from secure_uav_planner import Channel, fly_hover_fly, Plan, Scenario, solve
from secure_uav_planner.bound import explain_refusal, upper_bound
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.mission import Objective
from secure_uav_planner.output.page import save_page
from secure_uav_planner.output.picture import save_picture
from secure_uav_planner.output.tables import rate_table
from secure_uav_planner.ros.client import node_process, SecurePlanner
from secure_uav_planner.ros.planner_status import PlannerStatus
from secure_uav_planner.ros.recording import record

_MISSIONS = pathlib.Path(__file__).parents[1] / 'config'
_REPLAY_SPEED = 50.0
_PROOF = 10.0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--mission', default='paper',
                        help="'paper', 'city', or a mission file")
    parser.add_argument('--out', type=pathlib.Path,
                        help='folder for the results, by default out, or out/MISSION')
    parser.add_argument('--method', help="optimisation method, by default the planner's")
    options = parser.parse_args(argv)
    try:
        file = _mission_file(options.mission)
        scenario = Scenario.load(file) if file else Scenario.paper()
        out = options.out or pathlib.Path('out', file.stem if file else '')
        out.mkdir(parents=True, exist_ok=True)
        with isolated(out):
            plan = _plan_and_replay(scenario, file, options.method)
        plans = [fly_hover_fly(plan.scenario, 'constant'),
                 fly_hover_fly(plan.scenario, 'optimised'), plan]
        if refusal := explain_refusal(plan.scenario):
            print(f'no bound: {refusal}', flush=True)
        else:
            print(f'proving how good they are, for at most {_PROOF:g} s ...', flush=True)
            bound = upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                                time_limit=_PROOF)
            plans = [candidate.with_bound(bound) for candidate in plans]
        if not plan.scenario.channel.is_free_space:
            print('planning for free space, to see what that would cost ...', flush=True)
            plans.insert(2, plan_for_free_space(plan.scenario, plan.objective))
    except (PlanningError, OSError) as error:
        print(f'demo: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    print()
    *baselines, plan = plans
    print(rate_table(plans))
    files = [out / f'plan.{ending}' for ending in ('json', 'png', 'html', 'mcap')]
    plan.save(files[0])
    save_picture(plan, files[1], baselines)
    save_page(plan, files[2], baselines)
    record(plan, files[3])
    print(f'\nsaved: {", ".join(map(str, files))}')
    return 0


def plan_for_free_space(scenario: Scenario, objective: Objective) -> Plan:
    """Return a plan for free space with its rates in the scenario's channel."""
    plan = solve(replace(scenario, channel=Channel()), objective=objective)
    return replace(plan, scenario=scenario, method='planned for free space')


def _mission_file(mission: str) -> pathlib.Path | None:
    """Return the file of a mission by path or, in `config`, by name; None for the paper's."""
    file = pathlib.Path(mission)
    if file.suffix:
        return file
    return None if mission == 'paper' else _MISSIONS / f'{mission}.yaml'


def _plan_and_replay(scenario: Scenario, file: pathlib.Path | None, method: str | None) -> Plan:
    """Plan and replay the scenario of a file with the nodes; return the received plan."""
    parameters = ['-p', f'mission_file:={file}'] if file else []  # The paper's is the default.
    planner = [*parameters, '-p', f'method:={method}'] if method else parameters
    eve = scenario.eavesdroppers[0]
    position = np.subtract(eve.position, (eve.error_radius, 0.0))
    replay = [*parameters, '-p', f'speed:={_REPLAY_SPEED}',
              '-p', f'true_eavesdropper:={position.tolist()}']
    with node_process('planner', planner), node_process('replay', replay), \
            SecurePlanner(scenario, on_status=_print_progress) as client:
        client.wait_until(client.knows_poses, 'a status of the planner with all poses',
                          client.send_poses)
        print('planning ...', flush=True)
        plan = client.plan()
        client.wait_until(lambda: client.status.track.state == 'waiting', 'the replay')
        client.start()
        print(f'replaying at {_REPLAY_SPEED:g} times real time ...', flush=True)
        client.wait_until(lambda: client.status.track.state == 'ended', 'the end of the replay')
    return plan


def _print_progress(status: PlannerStatus) -> None:
    progress = status.progress
    if progress.step:
        print(f'  iteration {progress.iteration:>3}  {progress.rate:.4f} bit/s/Hz', flush=True)


if __name__ == '__main__':
    sys.exit(main())
