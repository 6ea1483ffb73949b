"""Shared by all views: colours, axes, labels, the margin of zones and fence, the map's extent."""

import math
from typing import Any

import numpy as np
import shapely

from ..mission import OBJECTIVES
from ..mission.polygons import convex_parts, offset_polygon
from ..mission.validation import rate_text

# Black, EAVESDROPPER and _UAVS are Okabe and Ito's colours, distinct for colour-blind readers.
GROUND_NODE = '#000000'
EAVESDROPPER = '#D55E00'
NO_FLY_ZONE = '#7A7A7A'
GEOFENCE = '#3C3C3C'
MARGIN = '#F4D58A'
RATE = '#6A3D9A'

_MOVING = (EAVESDROPPER, '#882255', '#999933')  # Colours that tell moving eavesdroppers apart.
_NODES = ('#332288', '#117733', '#AA4499', '#999933', '#882255', '#44AA99')  # Paul Tol's muted.
_UAVS = ('#0072B2', '#E69F00', '#009E73', '#CC79A7', '#56B4E9', '#F0E442')


def uav_color(index: int) -> str:
    """Return the colour of a UAV, '#rrggbb'; from the sixth jammer on, darker ones repeat."""
    if index == 0:
        return _UAVS[0]
    return _repeat_darker(_UAVS[1:], index - 1)


def _repeat_darker(colors: tuple[str, ...], index: int) -> str:
    """Return the colour of an index; beyond the last of the colours, darker ones repeat."""
    repeats, color = divmod(index, len(colors))
    channels = (int(colors[color][at:at + 2], 16) for at in (1, 3, 5))
    return '#' + ''.join(f'{round(channel * 0.6**repeats):02X}' for channel in channels)


def eavesdropper_color(index, eavesdropper):
    """Return the colour of an eavesdropper; only moving eavesdroppers have different colours."""
    return EAVESDROPPER if eavesdropper.track is None else _repeat_darker(_MOVING, index)


_SCHEME_NAMES = {
    'fly_hover_fly_constant': 'fly-hover-fly, constant power',
    'fly_hover_fly_optimised': 'fly-hover-fly, optimised power',
    'given': 'given by hand',
}
_SCHEME_DASHES = {'fly_hover_fly_constant': '--', 'fly_hover_fly_optimised': ':'}


def scheme_name(method):
    """Return the name of a method of solve or a baseline in words."""
    return _SCHEME_NAMES.get(method, method)


def scheme_dash(method):
    """Return the line style of Matplotlib of a baseline, the same in all views."""
    return _SCHEME_DASHES.get(method, '-.')


def distinct_paths(baselines):
    """Return (baseline, its scheme without the power) of the first of each set of equal paths."""
    distinct = []
    for baseline in baselines:
        if not any(np.array_equal(baseline.positions, earlier.positions)
                   for earlier, _ in distinct):
            distinct.append((baseline, scheme_name(baseline.method).partition(', ')[0]))
    return distinct


def node_color(scenario, index):
    """Return the colour of a ground node, '#rrggbb'; a single ground node is black."""
    several = len(scenario.ground_nodes) > 1
    return _repeat_darker(_NODES, index) if several else GROUND_NODE


def node_labels(scenario):
    """Return the names of the ground nodes for people, (G,)."""
    return ['ground node'] if scenario.is_plain_node else [*scenario.ground_node_names]


def style_axes(axes: Any) -> None:
    """Draw a faint grid behind everything; remove the frame at the top and at the right."""
    axes.grid(color='0.9', linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)


def add_legend(axes, *entries, **options):
    """Draw a legend, at the right of axes by default."""
    axes.legend(*entries, **{'loc': 'center left', 'bbox_to_anchor': (1.0, 0.5), 'fontsize': 9,
                             'frameon': False, **options})


def rate_label(plan):
    """Return a line: both rates over a Plan's promised slots; caveats if not all is guaranteed."""
    channel = plan.scenario.channel
    caveat = '' if channel.is_guarantee else f' {channel.promise}'
    guaranteed, worst = (channel.rate_name(name).removesuffix(caveat) for name in OBJECTIVES)
    promise = plan.promise
    return (f'{guaranteed} {rate_text(promise.guaranteed_rate, 3)}, '
            f'{worst} {rate_text(promise.worst_case_rate, 3)} '
            f'bit/s/Hz{caveat}' + (promise.text and f'; {promise.text}'))


def receiver_label(eavesdropper):
    """Return the advantage of an Eavesdropper's receiver, such as '+6 dB', '' without it."""
    advantage = eavesdropper.receiver_advantage_db
    return f'{advantage:+g} dB' if advantage else ''


def energy_label(energy):
    """Return an Energy as '29.3 kJ by the model (hovering 15.7)', '' for None."""
    return '' if energy is None else (
        f'{energy.total / 1e3:.3g} kJ by the model (hovering {energy.hovering / 1e3:.3g})')


def altitude_label(zone):
    """Return the forbidden altitudes of a zone, such as 'up to 50 m', '' if all are."""
    if math.isinf(zone.ceiling):
        return f'above {zone.floor:g} m' if zone.floor > 0 else ''
    return f'{zone.floor:g} to {zone.ceiling:g} m' if zone.floor > 0 else (
        f'up to {zone.ceiling:g} m')


def label_position(zone):
    """Return the mean corner (2,) [m] of the zone's convex part with the most room for a name."""
    def name_width(part):
        width, height = np.ptp(part, axis=0)
        return min(width, 3 * height)  # A name is about three times as wide as high.
    return max(convex_parts(zone.vertices), key=name_width).mean(axis=0)


def is_obstacle(zone, scenario):
    """Return True if a zone is at the altitude of a UAV, within the margin."""
    return any(zone.is_at(uav.altitude, scenario.tracking_margin) for uav in scenario.uavs)


def margin_rings(scenario):
    """Return the strips of the margin, each (K, 2) [m]: around obstacles, and inside the fence."""
    margin = scenario.tracking_margin
    if not margin:
        return []
    rings = [_ring(offset_polygon(zone.vertices, margin)[0], zone.vertices)
             for zone in scenario.no_fly_zones if is_obstacle(zone, scenario)]
    return rings if scenario.boundaries.keep_in is None else [
        *rings, _ring(scenario.geofence, scenario.boundaries.keep_in)]


def _ring(outer, inner):
    """Return the area between two outlines as one outline (K, 2) that joins them by a seam."""
    ring = shapely.Polygon(outer, [inner]).normalize()
    return np.concatenate([ring.exterior.coords, *(hole.coords for hole in ring.interiors),
                           ring.exterior.coords[:1]])


def list_tracks(scenario, times):
    """Return (name, track (K, 2) [m], colour) of each receiver that moves in times (K,) [s]."""
    grounds, centres, _ = scenario.receivers_at(times)
    names = [*node_labels(scenario), *scenario.eavesdropper_names]
    colors = [*(node_color(scenario, index) for index in range(len(grounds))),
              *(eavesdropper_color(*item) for item in enumerate(scenario.eavesdroppers))]
    receivers = zip(names, np.concatenate([grounds, centres]), colors, strict=True)
    return [(name, track, color) for name, track, color in receivers
            if np.ptp(track, axis=0).any()]


def shown_discs(scenario):
    """
    Return for each eavesdropper the list of its drawn discs (time [s], centre, radius [m]).

    Without a track it has one disc, at time 0. With a track it has three, also at duration / 2
    and at duration.
    """
    times = [0.0, scenario.duration / 2, scenario.duration]
    _, centres, radii = scenario.receivers_at(times)
    return [list(zip(times, track, reach.tolist()))[:3 if eve.track else 1]
            for eve, track, reach in zip(scenario.eavesdroppers, centres, radii)]


def map_extent(scenario, plans=()):
    """Return the map's corners (2, 2) [m], lower left and upper right, 7% around what it shows."""
    _, centres, radii = scenario.receivers
    points = np.concatenate([
        scenario.landmarks, *(centres - radii[..., None]), *(centres + radii[..., None]),
        *(plan.positions.reshape(-1, 2) for plan in plans)])
    low, high = extend_corners(scenario, [points.min(axis=0), points.max(axis=0)])
    margin = 0.07 * max(*(high - low), 10.0)
    return np.array([low - margin, high + margin])


def extend_corners(scenario, corners):
    """Return corners (2, 2) [m] moved out around zones and fence, by at most the longer side."""
    low, high = np.array(corners)
    most_shift = (high - low).max()
    fences = [] if scenario.geofence is None else [scenario.geofence]
    points = np.concatenate([corners, *(zone.vertices for zone in scenario.no_fly_zones), *fences])
    return np.array([np.maximum(points.min(axis=0), low - most_shift),
                     np.minimum(points.max(axis=0), high + most_shift)])
