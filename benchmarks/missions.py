"""Random missions of many kinds; the same seed gives the same mission."""

import numpy as np
from secure_uav_planner.mission.scenario import Eavesdropper, Scenario, Uav


def random_mission(seed, slots=None, jammers=None):
    """
    Return a random Scenario: 1 to 3 jammers, 1 to 3 eavesdroppers, error radius 0 to 60 m.

    Positions are within a square of 1.2 km, altitudes from 50 to 200 m, speeds from 8 to 20 m/s,
    average powers from 0.3 to 3 W with peaks of 1 to 6 times as much, and reference SNRs from 70
    to 90 dB. The duration is 2% to 150% longer than the straight flight needs, and there
    are 100 to 300 slots by default.
    """
    rng = np.random.default_rng([20, seed])
    drawn = int(rng.integers(1, 4))
    jammers = drawn if jammers is None else jammers
    eavesdroppers = tuple(
        Eavesdropper(tuple(rng.uniform(-400, 400, 2)), float(rng.uniform(0, 60)))
        for _ in range(int(rng.integers(1, 4))))
    uavs = []
    for number in range(1 + jammers):
        average = float(rng.uniform(0.3, 3.0))
        uavs.append(Uav(
            f'uav{number + 1}', start=tuple(rng.uniform(-600, 600, 2)),
            goal=tuple(rng.uniform(-600, 600, 2)), altitude=float(rng.uniform(50, 200)),
            max_speed=float(rng.uniform(8, 20)), average_power=average,
            peak_power=average * float(rng.uniform(1, 6))))
    slots = int(rng.integers(100, 301)) if slots is None else slots
    needed = max(np.hypot(*np.subtract(uav.goal, uav.start)) / uav.max_speed for uav in uavs)
    return Scenario(
        ground_node=tuple(rng.uniform(-100, 100, 2)), eavesdroppers=eavesdroppers,
        uavs=tuple(uavs), duration=float(needed * rng.uniform(1.02, 2.5)), slots=slots,
        reference_snr_db=float(rng.uniform(70, 90)))
