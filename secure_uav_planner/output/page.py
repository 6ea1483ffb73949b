"""The web page of a plan: one HTML file with a time slider, which needs no network."""

import html

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from .drawing import (
    altitude_label, EAVESDROPPER, GEOFENCE, GROUND_NODE, is_obstacle, label_position, list_ways,
    map_extent, MARGIN, margin_rings, NO_FLY_ZONE, RATE, rate_label, receiver_label, uav_color)
from ..mission.files import atomic_file
from ..model import channel

_MOST_FRAMES = 400
_PLAYING_TIME = 20.0  # In s.
_LEAST_POWER = 2e-5  # Of the axis, as a share of the largest peak power.
_SYMBOLS = ('circle', 'diamond', 'square', 'triangle-up', 'pentagon', 'star')
_DASHES = ('solid', 'dash', 'dot', 'dashdot')
_TITLE = 'Secure UAV plan'
# A phone shows the map at full size and scrolls to the rest beside it.
_STYLE = ('<meta name="viewport" content="width=device-width, initial-scale=1"><style>'
          'body { margin: 0 } #plan { min-width: 880px; min-height: 600px }</style>')
_JUMP = {'mode': 'immediate', 'transition': {'duration': 0},
         'frame': {'duration': 0, 'redraw': False}}


def save_page(plan, path):
    """Write the web page of a Plan to a self-contained HTML file, as atomic_file does."""
    # With a relative height, plotly resizes the figure with the window.
    figure = draw_page(plan).to_html(
        full_html=False, include_plotlyjs=True, auto_play=False, default_height='96vh',
        div_id='plan', config={'displaylogo': False, 'responsive': True})
    document = (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{_TITLE}'
                f'</title><link rel="icon" href="data:,">{_STYLE}</head>'
                f'<body>\n{figure}\n</body></html>\n')
    with atomic_file(path) as file:
        file.write(document)


def draw_page(plan):
    """Return the plotly Figure of a plan, with a frame for each point, at most _MOST_FRAMES."""
    content = _Content(plan)
    figure = make_subplots(
        3, 2, specs=[[{'rowspan': 3}, {}], [None, {}], [None, {}]], shared_xaxes='columns',
        column_widths=[0.42, 0.58], vertical_spacing=0.05, horizontal_spacing=0.08)
    static = [*content.static_traces()]
    for trace, row, column in (*static, *content.frame_traces(0)):
        figure.add_trace(trace, row, column)
    numbers = list(range(len(static), len(figure.data)))
    last = plan.scenario.slots + 1
    points = sorted({*np.linspace(0, last, min(last + 1, _MOST_FRAMES)).round().astype(int)})
    figure.frames = [
        go.Frame(name=str(point), traces=numbers, data=[
            trace for trace, _, _ in content.frame_traces(point)]) for point in points]
    _label_axes(figure, map_extent(plan.scenario, [plan]).T.tolist(), content.peak)
    _add_controls(figure, content, points)
    return figure


class _Content:
    """The traces and texts of a plan's page."""

    def __init__(self, plan):
        self.plan = plan
        scenario = plan.scenario
        self.peak = max(uav.peak_power for uav in scenario.uavs)
        step = scenario.slot_duration
        # Power n holds from point n to point n + 1, so nothing is delivered before point 1.
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

    def static_traces(self):
        """Yield the traces that all frames share, each with its row and column."""
        plan, times = self.plan, self.plan.times.tolist()
        for trace in _airspace_traces(plan.scenario):
            yield trace, 1, 1
        for way, color in list_ways(plan.scenario, plan.times):
            yield _scatter(way, mode='lines', showlegend=False, hoverinfo='skip',
                           line={'color': color, 'width': 1, 'dash': 'dash'}), 1, 1
        if not plan.scenario.has_tracks:
            yield from self._receiver_traces(0)
        for name, symbol in (('start', 'circle-open'), ('goal', 'square-open')):
            yield _scatter(  # Wider than the UAVs at these points.
                getattr(plan.scenario, f'{name}s'), mode='markers', name=name,
                marker={'symbol': symbol, 'size': 24, 'color': GEOFENCE}), 1, 1
        for index, (uav, path) in enumerate(zip(plan.scenario.uavs, plan.positions)):
            line = {'color': uav_color(index), 'width': 2, 'dash': _DASHES[index % 4]}
            shared = {'mode': 'lines', 'line': line, 'legendgroup': uav.name}
            yield _scatter(
                path, text=[f'{time:g} s, {watts:.3g} W'
                            for time, watts in zip(times, self.powers[index])],
                name=f'{uav.name} ({"jams" if index else "transmits"})', **shared), 1, 1
            # Zero has no logarithm: slots without power are gaps.
            watts = [power if power > 0 else None for power in self.powers[index].tolist()]
            yield go.Scatter(
                x=times, y=watts, name=uav.name, showlegend=False, connectgaps=False,
                **{**shared, 'line': {**line, 'shape': 'hv'}}), 1, 2
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
                    'shape': 'hv' if row == 2 else 'linear'}), row, 2

    def _receiver_traces(self, point):
        """Yield the discs and the ground node at a point, each with its row and column."""
        ground, centres, radii = self.receivers
        angle = np.linspace(0, 2 * np.pi, 73)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        for index, eve in enumerate(self.plan.scenario.eavesdroppers):
            yield _scatter(
                centres[index, point] + radii[index, point] * circle, fill='toself', mode='lines',
                line={'color': EAVESDROPPER, 'width': 1}, legendgroup='disc',
                showlegend=index == 0, name="eavesdropper's disc", hoverinfo='skip'), 1, 1
            if receiver_label(eve):
                yield _scatter(
                    centres[index, point][None], text=[receiver_label(eve)], mode='text',
                    textfont={'color': EAVESDROPPER}, legendgroup='disc', showlegend=False,
                    hoverinfo='skip'), 1, 1
        yield _scatter(
            ground[point][None], mode='markers', name='ground node',
            marker={'symbol': 'triangle-up', 'size': 14, 'color': GROUND_NODE}), 1, 1

    def frame_traces(self, point):
        """Yield the traces of the frame of a point, each with its row and column."""
        plan, time = self.plan, float(self.plan.times[point])
        if plan.scenario.has_tracks:
            yield from self._receiver_traces(point)
        for index, uav in enumerate(plan.scenario.uavs):
            watts = float(self.powers[index, point])
            yield _scatter(
                plan.positions[index, point][None], mode='markers', name=uav.name,
                legendgroup=uav.name, showlegend=False, text=[f'{watts:.3g} W'], marker={
                    'color': uav_color(index), 'symbol': _SYMBOLS[index % len(_SYMBOLS)],
                    # In good plans the jamming power is a hundredth of the transmit power. Markers
                    # of different sizes stay visible at the same position.
                    'size': float((17 if index == 0 else 10)
                                  + 2 * np.log1p(1000 * watts / self.peak)),
                    'line': {'color': 'white', 'width': 1.5}}), 1, 1
            yield _dot(time, watts if watts > 0 else None, uav_color(index), uav.name), 1, 2
        yield _scatter(
            [self.worst_places[point]], mode='markers', name='worst-case eavesdropper',
            marker={'symbol': 'x', 'size': 10, 'color': EAVESDROPPER,
                    'line': {'color': 'white', 'width': 1}}), 1, 1
        for values, row in ((self.guaranteed, 2), (self.delivered, 3)):
            yield _dot(time, float(values[point]), RATE, 'guaranteed'), row, 2

    def readout(self, point):
        """Return the text of the slider at a point, in a line."""
        time = float(self.plan.times[point])
        began = self.plan.scenario.slot_duration
        watts = ', '.join(
            f'{uav.name} {_power_label(power)}'
            for uav, power in zip(self.plan.scenario.uavs, self.powers[:, point]))
        mean = self.delivered[point] / (time - began) if point > 1 else 0.0
        return (f'{time:.1f} s:  {watts};  rate now {self.guaranteed[point]:.2f}, so far '
                f'{mean:.2f} bit/s/Hz, {self.delivered[point]:.1f} bit/Hz')


def _scatter(points, **options):
    """Return the trace of points, (K, 2)."""
    x, y = np.transpose(points).tolist()
    return go.Scatter(x=x, y=y, **options)


def _dot(x, y, color, group):
    return go.Scatter(x=[x], y=[y], mode='markers', legendgroup=group, showlegend=False,
                      hoverinfo='skip', cliponaxis=False, marker={'color': color, 'size': 9})


def _airspace_traces(scenario):
    """Yield fence and zones with their margins; zones at other altitudes are not filled."""
    for index, ring in enumerate(margin_rings(scenario)):
        yield _scatter(
            ring, mode='lines', fill='toself', line={'width': 0}, fillcolor=MARGIN,
            hoverinfo='skip', legendgroup='margin', showlegend=index == 0,
            name=f'margin of {scenario.tracking_margin:g} m')
    for index, (zone, name) in enumerate(zip(scenario.no_fly_zones, scenario.zone_names)):
        filled = is_obstacle(zone, scenario)
        yield _scatter(
            [*zone.vertices, zone.vertices[0]], mode='lines', fill='toself' if filled else 'none',
            line={'color': NO_FLY_ZONE, 'width': 1.5, 'dash': 'solid' if filled else 'dot'},
            legendgroup='zone', showlegend=index == 0, name='no-fly zone', hoveron='fills',
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
    return f'{power:.2f} W' if power >= 0.1 or power == 0 else f'{1000 * power:.1f} mW'


def _label_axes(figure, ranges, peak):
    figure.update_xaxes(title_text='east (m)', range=ranges[0], constrain='domain', row=1, col=1)
    figure.update_yaxes(title_text='north (m)', range=ranges[1], constrain='domain',
                        scaleanchor='x', row=1, col=1)
    figure.update_yaxes(title_text='power (W)', type='log', exponentformat='none', dtick=1,
                        range=np.log10([_LEAST_POWER * peak, 2 * peak]), row=1, col=2)
    figure.update_yaxes(title_text='secrecy rate<br>(bit/s/Hz)', rangemode='tozero', row=2, col=2)
    figure.update_yaxes(title_text='delivered<br>(bit/Hz)', rangemode='tozero', row=3, col=2)
    figure.update_xaxes(title_text='time (s)', row=3, col=2)
    figure.update_xaxes(ticks='outside')  # Keeps numbers off the marks at zero.
    figure.update_yaxes(ticks='outside')


def _add_controls(figure, content, points):
    plan = content.plan
    if plan.promise.is_partial:
        for row in (1, 2, 3):
            figure.add_vline(plan.promised_until, row=row, col=2, line={
                'color': GEOFENCE, 'width': 1.5, 'dash': 'dash'})
    title = f'{plan.method} plan: {rate_label(plan)}'
    if plan.bound is not None:
        title += f'<br><sup>{html.escape(plan.claim)}</sup>'
    play = {'mode': 'immediate', 'fromcurrent': True, 'transition': {'duration': 0},
            'frame': {'duration': 1000 * _PLAYING_TIME / len(points), 'redraw': False}}
    figure.update_layout(
        template='plotly_white', hovermode='closest', margin={'l': 60, 'r': 20, 't': 130, 'b': 80},
        title={'text': title, 'x': 0.01, 'yref': 'container', 'y': 1, 'yanchor': 'top',
               'pad': {'t': 25}},
        dragmode=False,  # A finger scrolls the page.
        legend={'orientation': 'h', 'yref': 'container', 'y': 0, 'yanchor': 'bottom'},
        sliders=[{
            'active': 0, 'x': 0.18, 'len': 0.82, 'y': 1, 'yanchor': 'bottom', 'pad': {'b': 10},
            # The labels of the steps are the readout; there is no room for them below the slider.
            'font': {'color': 'rgba(0,0,0,0)', 'size': 1},
            'ticklen': 0, 'tickcolor': 'rgba(0,0,0,0)',
            'currentvalue': {'font': {'color': '#222222', 'size': 14}},
            'steps': [{'label': content.readout(point), 'method': 'animate',
                       'args': [[str(point)], _JUMP]} for point in points]}],
        updatemenus=[{
            'type': 'buttons', 'direction': 'left', 'showactive': False, 'x': 0, 'y': 1,
            'xanchor': 'left', 'yanchor': 'bottom', 'pad': {'b': 10}, 'buttons': [
                {'label': '▶ play', 'method': 'animate', 'args': [None, play]},
                {'label': '❚❚', 'method': 'animate', 'args': [[None], _JUMP]}]}])
