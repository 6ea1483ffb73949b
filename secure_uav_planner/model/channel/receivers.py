"""Who receives what the UAVs radiate."""

from dataclasses import dataclass

import numpy as np

from .links import FreeSpace, links_of
from ..grid import Grid
from ...mission.scenario import Array


@dataclass(frozen=True, eq=False)
class Receivers:
    """
    The ground node (0) and the eavesdroppers (1..E), K = E + 1 receivers, in the units of a Grid.

    :param positions: (K, 2), or for every slot other ones, (N, K, 2).
    :param edge: epsilon that the guarantee adds to a distance, or subtracts from it, (K, U).
    :param link: of the UAVs, for arrays (..., K, U).
    """

    positions: Array
    edge: Array
    link: FreeSpace

    @classmethod
    def of(cls, grid: Grid) -> 'Receivers':
        """Return the receivers of a grid's scenario, with which the guarantee counts."""
        scenario = grid.scenario
        positions = np.concatenate([
            [grid.origin], scenario.eavesdropper_positions]) - grid.origin
        radii = np.append(0.0, scenario.error_radii)
        edge = np.repeat(radii[:, None], len(scenario.uavs), axis=1) / grid.length
        edge[:, 0] *= -1
        return cls(positions / grid.length, edge, links_of(scenario, grid.length, grid.power))

    def at_places(self, places: Array) -> 'Receivers':
        """Return eavesdroppers at P known places each instead of in discs, (N, E P, 2)."""
        ground = np.broadcast_to(self.positions[:1], (len(places), 1, 2))
        each = places.shape[-2] // (len(self.edge) - 1)
        copies = np.repeat(np.arange(len(self.edge)), [1] + [each] * (len(self.edge) - 1))
        link = self.link.taken(copies)
        return Receivers(np.concatenate([ground, places], axis=1),
                         np.zeros((1 + places.shape[-2], self.edge.shape[-1])), link)

    def rates(self, x: Array) -> tuple[Array, Array]:
        """Return r_0 (N,) and r_e to every eavesdropper (N, E) at x (N, U, 3) in nats."""
        offset = x[:, None, :, 1:] - self.positions[..., None, :]
        received = self.link.gain(offset[..., 0]**2 + offset[..., 1]**2) * x[:, None, :, 0]
        rates = np.log1p(received[..., 0] / (1.0 + received[..., 1:].sum(axis=-1)))
        return rates[:, 0], rates[:, 1:]
