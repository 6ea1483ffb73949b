"""The traces of a plan for Plotly: its map and its charts, for all pages that show it."""

import numpy as np
import plotly.graph_objects as go

from .drawing import (
    altitude_label, distinct_paths, EAVESDROPPER, eavesdropper_color, GEOFENCE, is_obstacle,
    label_position, list_tracks, MARGIN, margin_rings, NO_FLY_ZONE, node_color, node_labels, RATE,
    receiver_label, scheme_dash, scheme_name, uav_color)
from ..model import channel

_LEAST_POWER = 2e-5  # Least power on the axis, as a share of the largest peak power.
_SYMBOLS = ('circle', 'diamond', 'square', 'triangle-up', 'pentagon', 'star')
LINE_STYLES = ('solid', 'dash', 'dot', 'dashdot')  # Line styles of the UAVs, in turn.
_TRACK_MARKS = 5  # Number of times that are written along the track of a receiver.
_PLOTLY_DASHES = {'--': 'dash', ':': 'dot', '-.': 'dashdot'}  # Matplotlib's name: Plotly's.
_GREY = '#808080'
_SPACE = '\u2003\u2003'  # Gap between a disc and its name.


class PlanTraces:
    """
    The traces and texts of a plan.

    A method that yields (trace, row) gives each trace its row of charts: 1 power, 2 rate,
    3 delivered; None for the map.
    """

    def __init__(self, plan):
        """
        Set arrays with an entry for each point, 0 to N+1.

        Slot n lasts from point n to point n + 1, n = 1..N: power and rate are 0 at the points 0
        and N+1, and the bits [bit/Hz] delivered until a point are 0 at the points 0 and 1.
        """
        self.plan = plan
        scenario = plan.scenario
        self.peak = max(uav.peak_power for uav in scenario.uavs)
        step = scenario.slot_duration
        self.delivered, self.worst_delivered = (
            step * np.cumsum(np.pad(rates, (2, 0)))
            for rates in (plan.guaranteed_rates, plan.worst_case_rates))
        self.receivers = scenario.receivers_at(plan.times)
        self.powers = np.pad(plan.powers, ((0, 0), (1, 1)))
        self.guaranteed = np.pad(plan.guaranteed_rates, 1)
        self.worst = np.pad(plan.worst_case_rates, 1)
        self.worst_places = np.pad(
            channel.worst_case_places(scenario, plan.positions, plan.powers), ((1, 1), (0, 0)),
            mode='edge')

    def map_traces(self):
        """Yield what stands still on the map; receivers only if no receiver has a track."""
        plan = self.plan
        yield from margin_traces(plan.scenario)
        yield from _airspace_traces(plan.scenario)
        yield from self.track_traces()
        if not plan.scenario.has_tracks:
            yield from self._receiver_traces(0)
        for name, symbol in (('start', 'circle-open'), ('goal', 'square-open')):
            yield _scatter(  # The marker is wider than a UAV at the same point.
                getattr(plan.scenario, f'{name}s'), mode='markers', name=name,
                marker={'symbol': symbol, 'size': 24, 'color': GEOFENCE})

    def track_traces(self):
        """Yield for each moving receiver its track, and _TRACK_MARKS marks with times along it."""
        plan = self.plan
        marks = np.linspace(0, plan.scenario.slots + 1, _TRACK_MARKS).round().astype(int)
        for index, (name, track, color) in enumerate(list_tracks(plan.scenario, plan.times)):
            yield _scatter(track, mode='lines', name=f'track of {name}', hoverinfo='name',
                           line={'color': color, 'width': 1, 'dash': 'dash'})
            yield _scatter(
                track[marks], mode='markers+text', showlegend=False, hoverinfo='skip',
                text=[f'{round(time, 1):g} s' for time in plan.times[marks].tolist()],
                textposition='middle left' if index % 2 else 'middle right',
                textfont={'size': 10, 'color': color}, marker={'size': 4, 'color': color})

    def path_traces(self):
        """Yield the path of each UAV on the map."""
        for index, (uav, path) in enumerate(zip(self.plan.scenario.uavs, self.plan.positions)):
            yield _scatter(
                path, text=[f'{time:g} s, {watts:.3g} W' for time, watts in zip(
                    self.plan.times.tolist(), self.powers[index])],
                name=f'{uav.name} ({"jams" if index else "transmits"})', **_uav_style(index, uav))

    def flown_traces(self, comparison):
        """Yield (trace, chart row or None: map) of flown paths, and mean rates of the slots."""
        style = {'mode': 'lines', 'legendgroup': 'flown', 'name': 'flown', 'hoverinfo': 'skip',
                 'line': {'color': EAVESDROPPER, 'width': 1}}
        for index, path in enumerate(comparison.flight.positions):
            yield _scatter(path[:, :2], showlegend=not index, **style), None
        rates = np.where(comparison.covered, comparison.achieved['guaranteed'].sum(axis=0), np.nan)
        x, y = _steps(self.plan.times[1:], rates)
        yield go.Scatter(x=x, y=y, showlegend=False, **style), 2
        # Flown rates are means of slots; the rates of the plan are at its points.
        x, y = _steps(self.plan.times[1:], comparison.planned['guaranteed'].sum(axis=0))
        yield go.Scatter(x=x, y=y, mode='lines', hoverinfo='skip',
                         name='planned, mean of each slot', line={
                             'color': GEOFENCE, 'width': 1, 'dash': 'dash'}), 2

    def baseline_traces(self, baselines):
        """Yield (trace, chart row or None: map) of distinct paths and all guaranteed rates."""
        drawn = [baseline for baseline, _ in distinct_paths(baselines)]
        for baseline in baselines:
            dash = _PLOTLY_DASHES[scheme_dash(baseline.method)]
            style = {'mode': 'lines', 'legendgroup': baseline.method, 'hoverinfo': 'skip',
                     'name': scheme_name(baseline.method)}
            for path in baseline.positions if baseline in drawn else ():
                yield _scatter(path, showlegend=False,
                               line={'color': _GREY, 'width': 1, 'dash': dash}, **style), None
            yield go.Scatter(
                x=baseline.times.tolist(), y=np.pad(baseline.guaranteed_rates, 1).tolist(),
                line={'color': _GREY, 'width': 1.5, 'dash': dash, 'shape': 'hv'}, **style), 2

    def chart_traces(self):
        """Yield (trace, chart row) of powers (1), rates (2) and delivered bits (3) over time."""
        plan, times = self.plan, self.plan.times.tolist()
        for index, uav in enumerate(plan.scenario.uavs):
            # Zero has no logarithm: slots without power are gaps.
            watts = plan.powers[index]
            x, y = _steps(plan.times[1:], np.where(watts > 0, watts, np.nan))
            yield go.Scatter(x=x, y=y, name=uav.name, showlegend=False, connectgaps=False,
                             **_uav_style(index, uav)), 1
        for values, dash, width, name, row in (
                (self.worst, 'dash', 1.5, 'worst_case', 2),
                (self.guaranteed, 'solid', 2.5, 'guaranteed', 2),
                (self.worst_delivered, 'dash', 1.5, 'worst_case', 3),
                (self.delivered, 'solid', 2.5, 'guaranteed', 3)):
            yield go.Scatter(
                x=times, y=values.tolist(), mode='lines',
                name=plan.scenario.channel.rate_name(name), legendgroup=name,
                showlegend=row == 2, line={
                    'color': RATE, 'width': width, 'dash': dash,
                    'shape': 'hv' if row == 2 else 'linear'}), row

    def _receiver_traces(self, point):
        """Yield eavesdroppers' discs and ground nodes at a point of the plan, 0 to N + 1."""
        grounds, centres, radii = self.receivers
        angle = np.linspace(0, 2 * np.pi, 73)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        for index, (eve, name) in enumerate(zip(
                self.plan.scenario.eavesdroppers, self.plan.scenario.eavesdropper_names)):
            color = eavesdropper_color(index, eve)
            yield _scatter(
                centres[index, point] + radii[index, point] * circle, fill='toself', mode='lines',
                line={'color': color, 'width': 1}, legendgroup='disc',
                showlegend=index == 0, name="eavesdropper's disc", hoverinfo='skip')
            label = ' '.join(filter(None, (eve.track and name, receiver_label(eve))))
            if label:
                side, text = ('right', _SPACE + label) if index % 2 else ('left', label + _SPACE)
                yield _scatter(  # The times of a track of this number are on the other side.
                    centres[index, point][None], text=[text], mode='text',
                    textposition=f'middle {side}',
                    textfont={'color': color}, legendgroup='disc', showlegend=False,
                    hoverinfo='skip')
        scenario = self.plan.scenario
        for index, (name, track) in enumerate(zip(node_labels(scenario), grounds, strict=True)):
            yield _scatter(
                track[point][None], mode='markers', name=name, marker={
                    'symbol': 'triangle-up', 'size': 14, 'color': node_color(scenario, index)})

    def moving_traces(self, point):
        """Yield (trace, chart row or None for the map) of what differs by point, at one point."""
        plan, time = self.plan, float(self.plan.times[point])
        if plan.scenario.has_tracks:
            for trace in self._receiver_traces(point):
                yield trace, None
        for index, uav in enumerate(plan.scenario.uavs):
            watts = float(self.powers[index, point])
            yield _scatter(
                plan.positions[index, point][None], mode='markers', name=uav.name,
                legendgroup=uav.name, showlegend=False, text=[f'{watts:.3g} W'], marker={
                    'color': uav_color(index), 'symbol': _SYMBOLS[index % len(_SYMBOLS)],
                    # The size is logarithmic, as good plans jam with a hundredth of the transmit
                    # power. The transmitter is larger, so that a jammer above it stays visible.
                    'size': float((17 if index == 0 else 10)
                                  + 2 * np.log1p(1000 * watts / self.peak)),
                    'line': {'color': 'white', 'width': 1.5}}), None
            yield _dot(time, watts if watts > 0 else None, uav_color(index), uav.name), 1
        yield _scatter(
            [self.worst_places[point]], mode='markers', name='worst-case eavesdropper',
            marker={'symbol': 'x', 'size': 10, 'color': EAVESDROPPER,
                    'line': {'color': 'white', 'width': 1}}), None
        for values, row in ((self.guaranteed, 2), (self.delivered, 3)):
            yield _dot(time, float(values[point]), RATE, 'guaranteed'), row

    def readout(self, point):
        """Return the slider's text at a point: time, powers, rate, mean rate and bits so far."""
        time = float(self.plan.times[point])
        first_slot_begin = self.plan.scenario.slot_duration
        watts = ', '.join(
            f'{uav.name} {_power_label(power)}'
            for uav, power in zip(self.plan.scenario.uavs, self.powers[:, point]))
        mean = self.delivered[point] / (time - first_slot_begin) if point > 1 else 0.0
        return (f'{time:.1f} s:  {watts};  rate now {self.guaranteed[point]:.2f}, so far '
                f'{mean:.2f} bit/s/Hz, {self.delivered[point]:.1f} bit/Hz')


def power_range(plan):
    """Return log10 of the limits of the power axis in W, which are at least a decade apart."""
    peak = max(uav.peak_power for uav in plan.scenario.uavs)
    shown = plan.powers[plan.powers >= _LEAST_POWER * peak]
    return np.log10([min(shown.min(initial=peak) / 1.5, peak / 10), 2 * peak]).tolist()


def label_charts(figure, column):
    """Label the axes of a column of charts: power (logarithmic), rate, delivered bits, by row."""
    figure.update_yaxes(title_text='power (W)', type='log', exponentformat='none', dtick=1,
                        row=1, col=column)
    figure.update_yaxes(title_text='secrecy rate<br>(bit/s/Hz)', rangemode='tozero',
                        row=2, col=column)
    figure.update_yaxes(title_text='delivered<br>(bit/Hz)', rangemode='tozero',
                        row=3, col=column)
    figure.update_xaxes(title_text='time (s)', row=3, col=column)
    figure.update_xaxes(ticks='outside')  # Keeps numbers off the marks at zero.
    figure.update_yaxes(ticks='outside')


def _uav_style(index, uav):
    """Return the style of the lines of a UAV, on the map and in its chart."""
    return {'mode': 'lines', 'legendgroup': uav.name,
            'line': {'color': uav_color(index), 'width': 2,
                     'dash': LINE_STYLES[index % len(LINE_STYLES)]}}


def _scatter(points, **options):
    """Return the trace of points, (K, 2)."""
    x, y = np.transpose(points).tolist()
    return go.Scatter(x=x, y=y, **options)


def _steps(edges, values):
    """
    Return x and y of the line of values (N,) that each hold between two of the edges (N + 1,).

    A value that is not finite is a gap. Plotly's line shape 'hv' would not draw the value before
    a gap, nor the last one.
    """
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(values, 2)
    return x.tolist(), [value if np.isfinite(value) else None for value in y.tolist()]


def _dot(x, y, color, group):
    return go.Scatter(x=[x], y=[y], mode='markers', legendgroup=group, showlegend=False,
                      hoverinfo='skip', cliponaxis=False, marker={'color': color, 'size': 9})


def margin_traces(scenario):
    """Yield the margins of zones and fence."""
    for index, ring in enumerate(margin_rings(scenario)):
        yield _scatter(
            ring, mode='lines', fill='toself', line={'width': 0}, fillcolor=MARGIN,
            hoverinfo='skip', legendgroup='margin', showlegend=index == 0,
            name=f'margin of {scenario.tracking_margin:g} m')


def _airspace_traces(scenario):
    """Yield fence and zones; zones at other altitudes are not filled."""
    kinds = []
    for zone, name in zip(scenario.no_fly_zones, scenario.zone_names):
        filled = is_obstacle(zone, scenario)
        kinds.append('no-fly zone' if filled else 'no-fly zone at other altitudes')
        yield _scatter(
            [*zone.vertices, zone.vertices[0]], mode='lines', fill='toself' if filled else 'none',
            line={'color': NO_FLY_ZONE, 'width': 1.5, 'dash': 'solid' if filled else 'dot'},
            legendgroup=kinds[-1], showlegend=kinds.count(kinds[-1]) == 1, name=kinds[-1],
            hoveron='fills',
            text=', '.join(filter(None, (name, altitude_label(zone)))), hoverinfo='text')
    if scenario.no_fly_zones:
        yield _scatter(
            [label_position(zone) for zone in scenario.no_fly_zones], mode='text',
            text=list(scenario.zone_names), textfont={'size': 10, 'color': GEOFENCE},
            showlegend=False, hoverinfo='skip')
    if scenario.geofence is not None:
        yield _scatter(
            [*scenario.geofence, scenario.geofence[0]], mode='lines', name='geofence',
            hoverinfo='name', line={'color': GEOFENCE, 'width': 1.5, 'dash': 'dash'})


def _power_label(power):
    return f'{power:.2f} W' if power >= 0.1 or power == 0 else f'{1000 * power:.3g} mW'
