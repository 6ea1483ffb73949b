"""The picture of a flight: planned and flown paths, and the error over time."""

from matplotlib.figure import Figure
import numpy as np

from ..view.colors import EAVESDROPPER, GROUND_NODE, uav_color
from ..view.picture import draw_airspace


def save_flight(name, flight, path):
    """Draw a Flight into a PNG file."""
    figure = Figure(figsize=(11, 5), layout='constrained')
    above, over = figure.subplots(1, 2)
    planned, scenario = flight.planned, flight.plan.scenario
    for index, uav in enumerate(scenario.uavs):
        color = uav_color(index)
        above.plot(*planned[index, :, :2].T, color=color, lw=4, alpha=0.3)
        above.plot(*flight.places[index, :, :2].T, color=color, lw=1, label=uav.name)
        error = np.linalg.norm(flight.places[index] - planned[index], axis=-1)
        over.plot(flight.times, error, color=color, lw=1, label=uav.name)
    draw_airspace(above, scenario)
    above.plot(*scenario.ground_node, '^', color=GROUND_NODE, ms=9)
    for eve in scenario.eavesdroppers:
        angle = np.linspace(0, 2 * np.pi, 100)
        x, y = np.array(eve.position)[:, None] + eve.error_radius * np.array(
            [np.cos(angle), np.sin(angle)])
        above.fill(x, y, color=EAVESDROPPER, alpha=0.4)
        above.plot(*eve.position, 'x', color=EAVESDROPPER)
    figure.suptitle(name)
    above.set(title='planned (broad) and flown (thin)', xlabel='x (m)', ylabel='y (m)')
    above.set_aspect('equal', 'datalim')
    above.legend()
    over.set(title='distance from the planned curve', xlabel='time (s)', ylabel='m')
    over.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
