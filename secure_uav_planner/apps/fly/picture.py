"""The pictures of flights: planned and flown paths, and what changes over time."""

from matplotlib.figure import Figure
import numpy as np

from ...output.drawing import EAVESDROPPER, GROUND_NODE, RATE, uav_color
from ...output.picture import draw_airspace


def save_flight(name, flight, path):
    """Draw a SimulatedFlight into a PNG file."""
    figure = Figure(figsize=(11, 5), layout='constrained')
    above, over = figure.subplots(1, 2)
    planned, scenario = flight.planned, flight.plan.scenario
    for index, uav in enumerate(scenario.uavs):
        color = uav_color(index)
        above.plot(*planned[index, :, :2].T, color=color, lw=4, alpha=0.3)
        above.plot(*flight.places[index, :, :2].T, color=color, lw=1, label=uav.name)
        error = np.linalg.norm(flight.places[index] - planned[index], axis=-1)
        over.plot(flight.times, error, color=color, lw=1, label=uav.name)
    figure.suptitle(name)
    _finish_map(above, scenario, 'planned (broad) and flown (thin)')
    over.set(title='distance from the planned curve', xlabel='time (s)', ylabel='m')
    over.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def save_event_flight(flight, path):
    """Draw an EventFlight into a PNG file: the map, and the stream of setpoints over time."""
    figure = Figure(figsize=(13, 8), layout='constrained')
    axes = figure.subplot_mosaic([['map', kind] for kind in ('way', 'speed', 'time', 'error')],
                                 width_ratios=(1, 1.2))
    above, scenario, times = axes.pop('map'), flight.scenario, flight.times
    for index, uav in enumerate(scenario.uavs):
        color = uav_color(index)
        above.plot(*flight.points[index].T, color=color, lw=5, alpha=0.25)
        above.plot(*flight.setpoints[index, :, :2].T, '--', color='black', lw=1)
        above.plot(*flight.places[index, :, :2].T, color=color, lw=1, label=uav.name)
        moves = np.linalg.norm(np.diff(flight.setpoints[index], axis=0), axis=-1)
        error = np.linalg.norm(flight.places[index] - flight.setpoints[index], axis=-1)
        for kind, values in (
                ('way', np.cumsum([0.0, *moves])), ('error', error),
                ('speed', np.linalg.norm(flight.velocities[index], axis=-1))):
            axes[kind].plot(times, values, color=color, lw=1.2, label=uav.name)
    axes['time'].plot(times, times, color='0.6', lw=1, label='the clock')
    axes['time'].plot(times, flight.plan_times, color='black', lw=1.2, label='the plan')
    for number, turn in enumerate(flight.turns):
        for kind, one in axes.items():
            one.axvline(turn, color=RATE, lw=0.8, alpha=0.6, label='' if number or kind != 'time'
                        else 'the replay goes over to another plan')
    axes['time'].legend(loc='upper left', fontsize=8)
    titles = {'way': 'way of the setpoint along its path (m)',
              'speed': 'speed of the setpoint (m/s)', 'time': 'time of the plan by its stamps (s)',
              'error': 'distance of the UAV from its setpoint (m)'}
    for kind, one in axes.items():
        one.set_title(titles[kind], loc='left', fontsize=10)
        one.set_xlim(times[0], times[-1])
        one.grid(alpha=0.3)
        for mark, (time, text) in enumerate(flight.marks):
            one.axvline(time, color='0.3', lw=1, ls=':')
            if kind == 'way':
                one.annotate(text, (time, 1), xycoords=('data', 'axes fraction'), fontsize=8,
                             xytext=(3, -11 - 11 * (mark % 2)), textcoords='offset points')
    axes['error'].set_xlabel('time since point 0 of the first plan, by the clock (s)')
    figure.suptitle(flight.event.name)
    _finish_map(above, scenario, 'first plan (broad), setpoints (dashed) and flown (thin)')
    figure.savefig(path, dpi=110)


def _finish_map(axes, scenario, title):
    """Draw what stands on the ground, and name the axes."""
    draw_airspace(axes, scenario)
    axes.plot(*scenario.ground_node, '^', color=GROUND_NODE, ms=9, label='ground node')
    for eve, name in zip(scenario.eavesdroppers, scenario.eavesdropper_names, strict=True):
        angle = np.linspace(0, 2 * np.pi, 100)
        x, y = np.array(eve.position)[:, None] + eve.error_radius * np.array(
            [np.cos(angle), np.sin(angle)])
        axes.fill(x, y, color=EAVESDROPPER, alpha=0.4)
        axes.plot(*eve.position, 'x', color=EAVESDROPPER, label=name)
    axes.set(title=title, xlabel='east (m)', ylabel='north (m)')
    axes.set_aspect('equal', 'datalim')
    axes.grid(alpha=0.3)
    axes.legend()
