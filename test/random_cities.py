"""Random missions with all limits at once; the same seed gives the same mission."""

import numpy as np
from secure_uav_planner import Eavesdropper, NoFlyZone, Scenario, Uav
import shapely


def random_city_mission(seed, slots=None, slack=None):
    """
    Return a random Scenario with all limits at once: a mission in a city.

    There are 1 to 3 UAVs at two altitudes, in three of four missions with limits of acceleration
    from 1.5 to 6 m/s^2; separations from 5 to 30 m; 2 to 8 zones of 60 to 360 m, half of
    them not convex, some below or above some of the UAVs; and a fence around, convex or not.
    Ends are outside the zones and apart; where a flight may still be impossible in the duration,
    solve refuses the mission.

    :param seed: the seed of the mission.
    :param slots: N, by default 60 to 200.
    :param slack: share by which the duration is longer than the straight flight needs; by
        default from 0.05 to 1.2.
    """
    rng = np.random.default_rng([21, seed])
    fence = _outline(rng, (0.0, 0.0), 900.0, 0.15 if rng.random() < 0.5 else 0.0)
    zones = []
    for number in range(int(rng.integers(2, 9))):
        floor = 0.0 if rng.random() < 0.8 else 85.0
        zones.append(NoFlyZone(
            _outline(rng, rng.uniform(-400, 400, 2), float(rng.uniform(30, 180)),
                     0.6 if rng.random() < 0.5 else 0.0),
            floor=floor, ceiling=np.inf if rng.random() < 0.8 else 95.0,
            name=f'zone {number + 1}'))
    separation = float(rng.uniform(5, 30))
    polygons = [shapely.Polygon(zone.vertices) for zone in zones]
    inside = shapely.Polygon(fence).buffer(-10.0)
    ends = {'start': [], 'goal': []}

    def place(end):
        while True:
            position = rng.uniform(-500, 500, 2)
            point = shapely.Point(position)
            if (inside.contains(point) and all(polygon.distance(point) > 5 for polygon in polygons)
                    and all(np.hypot(*(position - taken)) > 1.1 * separation
                            for taken in ends[end])):
                ends[end].append(position)
                return tuple(position.tolist())

    limited = rng.random() < 0.75
    uavs = []
    for number in range(int(rng.integers(1, 4))):
        average = float(rng.uniform(0.3, 3.0))
        uavs.append(Uav(
            f'uav{number + 1}', start=place('start'), goal=place('goal'),
            altitude=float(rng.choice([80.0, 100.0])), max_speed=float(rng.uniform(8, 20)),
            average_power=average, peak_power=average * float(rng.uniform(1, 6)),
            max_acceleration=float(rng.uniform(1.5, 6)) if limited else None))
    slots = int(rng.integers(60, 201)) if slots is None else slots
    slack = float(rng.uniform(0.05, 1.2)) if slack is None else slack
    needed = max(
        np.hypot(*np.subtract(uav.goal, uav.start)) / uav.max_speed
        + (0.0 if uav.max_acceleration is None else uav.max_speed / uav.max_acceleration)
        for uav in uavs)
    return Scenario(
        ground_node=tuple(rng.uniform(-100, 100, 2)),
        eavesdroppers=tuple(
            Eavesdropper(tuple(rng.uniform(-400, 400, 2)), float(rng.uniform(0, 60)))
            for _ in range(int(rng.integers(1, 3)))),
        uavs=tuple(uavs), duration=max(20.0, needed * (1 + slack)), slots=slots,
        reference_snr_db=float(rng.uniform(70, 90)), separation=separation,
        no_fly_zones=tuple(zones), geofence=fence)


def random_polygon(rng, centre, size, most_corners=24):
    """Return the vertices of a simple polygon around a centre, most of them far from convex."""
    while True:
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, most_corners + 1)))
        radii = size * rng.uniform(0.05, 1, len(angles))
        points = centre + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        if shapely.Polygon(points).is_valid:
            return tuple(map(tuple, points.tolist()))


def _outline(rng, centre, size, roughness):
    """Return the vertices of a star-shaped polygon; without roughness it is convex."""
    corners = int(rng.integers(4, 10))
    angles = 2 * np.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
    radii = size * (1 - roughness * rng.random(corners))
    return tuple((float(centre[0] + radius * np.cos(angle)),
                  float(centre[1] + radius * np.sin(angle)))
                 for radius, angle in zip(radii, angles))
