"""What all views have in common: colours, labels, style, and the shapes of zones and geofence."""

import math

import numpy as np
import shapely

from ..mission import OBJECTIVES
from ..mission.polygons import convex_parts, offset_polygon

# By Okabe and Ito, which colour-blind people can distinguish.
GROUND_NODE = '#000000'
EAVESDROPPER = '#D55E00'
NO_FLY_ZONE = '#7A7A7A'
GEOFENCE = '#3C3C3C'
MARGIN = '#F4D58A'
RATE = '#6A3D9A'

_UAVS = ('#0072B2', '#E69F00', '#009E73', '#CC79A7', '#56B4E9', '#F0E442')


def uav_color(index):
    """Return the colour of a UAV by index, '#rrggbb'; UAV 0 transmits, later rounds are darker."""
    if index == 0:
        return _UAVS[0]
    rounds, color = divmod(index - 1, len(_UAVS) - 1)
    parts = (int(_UAVS[1 + color][at:at + 2], 16) for at in (1, 3, 5))
    return '#' + ''.join(f'{round(part * 0.6**rounds):02X}' for part in parts)


def style_axes(axes):
    """Draw a faint grid behind everything, and no frame at the top and at the right."""
    axes.grid(color='0.9', linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)


def add_legend(axes, *entries, **options):
    """Draw a legend to the right of axes."""
    axes.legend(*entries, loc='center left', bbox_to_anchor=(1.0, 0.5), fontsize=9,
                frameon=False, **options)


def rates_text(plan):
    """Return the rates of a Plan with their names, in one line."""
    channel = plan.scenario.channel
    caveat = '' if channel.is_guarantee else f' {channel.promise}'
    bound, worst = (channel.rate_name(name).removesuffix(caveat) for name in OBJECTIVES)
    return (f'{bound} {plan.guaranteed_rate:.3f}, {worst} {plan.worst_case_rate:.3f} '
            f'bit/s/Hz{caveat}')


def receiver_label(eavesdropper):
    """Return the advantage of an Eavesdropper's receiver, such as '+6 dB', '' without one."""
    advantage = eavesdropper.receiver_advantage_db
    return f'{advantage:+g} dB' if advantage else ''


def energy_label(energy):
    """Return an Energy in words, such as '29.3 kJ (hovering 15.7)', '' for None."""
    return '' if energy is None else (
        f'{energy.total / 1e3:.3g} kJ (hovering {energy.hovering / 1e3:.3g})')


def altitudes_of(zone):
    """Return at which altitudes a zone is forbidden, in words, or '' for all of them."""
    if math.isinf(zone.ceiling):
        return f'above {zone.floor:g} m' if zone.floor > 0 else ''
    return f'{zone.floor:g} to {zone.ceiling:g} m' if zone.floor > 0 else (
        f'up to {zone.ceiling:g} m')


def middle_of(zone):
    """Return a place in the widest part of a zone, (2,) in m."""
    return max(convex_parts(zone.vertices), key=lambda part: np.ptp(part, axis=0).min()).mean(
        axis=0)


def is_in_the_way(zone, scenario):
    """Return whether a zone is within the margin of the altitude of any UAV."""
    return any(zone.is_at(uav.altitude, scenario.tracking_margin) for uav in scenario.uavs)


def rims(scenario):
    """Return what the margin adds to zones in the way and takes from the fence, each (K, 2)."""
    margin = scenario.tracking_margin
    if not margin:
        return []
    found = [_ring(offset_polygon(zone.vertices, margin)[0], zone.vertices)
             for zone in scenario.no_fly_zones if is_in_the_way(zone, scenario)]
    return found if scenario.keep_in is None else [
        *found, _ring(scenario.geofence, scenario.keep_in)]


def _ring(outer, inner):
    """Return what is between two outlines as one, with a seam."""
    ring = shapely.Polygon(outer, [inner]).normalize()
    return np.concatenate([ring.exterior.coords, *(hole.coords for hole in ring.interiors),
                           ring.exterior.coords[:1]])


def extent_of(scenario, plans=()):
    """Return the lower left and the upper right corner of the map of some plans, (2, 2) in m."""
    radii = scenario.error_radii[:, None]
    points = np.concatenate([
        [scenario.ground_node], scenario.starts, scenario.goals,
        scenario.eavesdropper_positions - radii, scenario.eavesdropper_positions + radii,
        *(plan.positions.reshape(-1, 2) for plan in plans)])
    low, high = np.array(corners_of_map(scenario, [points.min(axis=0), points.max(axis=0)]))
    margin = 0.07 * max(*(high - low), 10.0)
    return np.array([low - margin, high + margin])


def corners_of_map(scenario, corners):
    """Return corners (2, 2) in m, extended to zones and fence as far as the plan stays large."""
    low, high = np.array(corners)
    most = (high - low).max()
    fences = [] if scenario.geofence is None else [scenario.geofence]
    points = np.concatenate([corners, *(zone.vertices for zone in scenario.no_fly_zones), *fences])
    return [np.maximum(points.min(axis=0), low - most).tolist(),
            np.minimum(points.max(axis=0), high + most).tolist()]
