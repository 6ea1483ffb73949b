"""
Plan a mission over a city and show plan and flight in RViz.

RViz is started where it is installed; without it, the nodes publish the same for any other viewer.
"""

from pathlib import Path
import shutil
import subprocess

from secure_uav_planner import Scenario
from secure_uav_planner.ros.client import node_process, SecurePlanner

CONFIG = Path(__file__).resolve().parents[2] / 'config'


def main(speed=10.0):
    """Fly the mission of config/city.yaml, at a speed in multiples of real time."""
    mission = ['-p', f'mission_file:={CONFIG / "city.yaml"}']
    viewer = None
    if shutil.which('rviz2'):
        viewer = subprocess.Popen(['rviz2', '-d', str(CONFIG / 'planner.rviz')])
    else:
        print('rviz2 is not installed; the topics are planner/markers and replay/markers')
    with node_process('planner', mission), \
            node_process('replay', [*mission, '-p', f'speed:={speed}']), \
            SecurePlanner(Scenario.load(CONFIG / 'city.yaml')) as planner:
        planner.wait_until(planner.knows_poses, 'a planner that knows all poses',
                           planner.send_poses)
        planner.plan()
        print(planner.start())
        planner.wait_until(lambda: planner.status.track.state == 'ended', 'the end')
    if viewer is not None:
        viewer.wait()


if __name__ == '__main__':
    main()
