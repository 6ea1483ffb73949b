"""The picture of a flight: planned and flown paths, and the setpoints over time."""

from matplotlib.figure import Figure
import numpy as np
from secure_uav_planner.output.drawing import RATE, uav_color
from secure_uav_planner.output.map import draw_ground

_PANELS = {'way': 'way of the setpoint along its path (m)', 'speed': 'speed of the setpoint (m/s)',
           'time': 'time of the plan by its stamps (s)',
           'error': 'distance of the UAV from its setpoint (m)'}


def save_flight(flight, path):
    """Draw a Flight into a PNG file: the map, and the stream of setpoints over time."""
    figure = Figure(figsize=(13, 8), layout='constrained')
    axes = figure.subplot_mosaic([['map', kind] for kind in _PANELS], width_ratios=(1, 1.2))
    above, times = axes.pop('map'), flight.times
    for index, uav in enumerate(flight.scenario.uavs):
        style = {'color': uav_color(index), 'lw': 1.2}
        above.plot(*flight.planned[index].T, color=style['color'], lw=5, alpha=0.25)
        above.plot(*flight.setpoints[index, :, :2].T, '--', color='black', lw=1)
        above.plot(*flight.places[index, :, :2].T, label=uav.name, **style)
        moves = np.linalg.norm(np.diff(flight.setpoints[index], axis=0), axis=-1)
        axes['way'].plot(times, np.cumsum([0.0, *moves]), **style)
        axes['speed'].plot(times, np.linalg.norm(flight.velocities[index], axis=-1), **style)
        axes['error'].plot(times, np.linalg.norm(
            flight.places[index] - flight.setpoints[index], axis=-1), **style)
    axes['time'].plot(times, times, color='0.6', lw=1, label='the clock')
    axes['time'].plot(times, flight.plan_times, color='black', lw=1.2, label='the plan')
    for kind, panel in axes.items():
        panel.set_title(_PANELS[kind], loc='left', fontsize=10)
        panel.set_xlim(times[0], times[-1])
        panel.grid(alpha=0.3)
        for number, splice in enumerate(flight.splices):
            panel.axvline(splice, color=RATE, lw=0.8, alpha=0.6, label='' if number else
                          'the replay continues with another plan')
        for mark, (time, text) in enumerate(flight.marks):
            panel.axvline(time, color='0.3', lw=1, ls=':')
            if kind == 'way':
                panel.annotate(text, (time, 1), xycoords=('data', 'axes fraction'), fontsize=8,
                               xytext=(3, -11 - 11 * (mark % 2)), textcoords='offset points')
    axes['time'].legend(loc='upper left', fontsize=8)
    axes['error'].set_xlabel('time since point 0 of the first plan, by the clock (s)')
    figure.suptitle(flight.event.name)
    draw_ground(above, flight.scenario)
    above.set(title='first plan (broad), setpoints (dashed) and flown (thin)', xlabel='east (m)',
              ylabel='north (m)')
    above.set_aspect('equal', 'datalim')
    above.grid(alpha=0.3)
    entries = {label: artist for artist, label in zip(*above.get_legend_handles_labels())}
    above.legend(entries.values(), entries)
    figure.savefig(path, dpi=110)
