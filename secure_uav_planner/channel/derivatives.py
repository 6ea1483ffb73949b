"""The rates of a slot with their exact gradients and Hessians, for all slots at once."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .links import FreeSpace, SmoothDiscDistance
from ..grid import Grid
from ..scenario import Array


@dataclass(frozen=True, eq=False)
class Receivers:
    """
    Who receives what the UAVs radiate, in the units of a Grid.

    Receivers are the ground node (0) and the eavesdroppers (1..E), K = E + 1 in all.

    :param positions: of the receivers, (K, 2), or for every slot other ones, (..., N, K, 2).
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
        link = FreeSpace(scenario.reference_snr * grid.power / grid.length**2,
                         (scenario.altitudes / grid.length)**2)
        advantages = np.append(1.0, scenario.receiver_advantages)[:, None]
        return cls(positions / grid.length, edge, link.for_receivers(advantages))

    def at_places(self, places: Array) -> 'Receivers':
        """
        Return the ground node with eavesdroppers at known places instead of in discs.

        :param places: in units of the grid, (..., N, E P, 2), P for each eavesdropper.
        """
        ground = np.broadcast_to(self.positions[..., :1, :], (*places.shape[:-2], 1, 2))
        each = places.shape[-2] // (len(self.edge) - 1)
        copies = np.repeat(np.arange(len(self.edge)), [1] + [each] * (len(self.edge) - 1))
        link = replace(self.link, reference_snr=np.asarray(self.link.reference_snr)[copies])
        return Receivers(np.concatenate([ground, places], axis=-2),
                         np.zeros((1 + places.shape[-2], self.edge.shape[-1])), link)


class SlotRates:
    """
    The rates at one x in nats, and their derivatives on request.

    The kink of (d + eps)^2 at d = 0 is rounded as SmoothDiscDistance does.

    :param receivers: who receives.
    :param x: variables of a Grid, (..., N, U, 3).
    :param softening: of the jammers' distances, a number or an array of shape (..., 1).
    :ivar ground: r_0 of every slot, (..., N).
    :ivar leaks: r_e to every eavesdropper, (..., N, E).
    """

    def __init__(self, receivers: Receivers, x: Array, softening: ArrayLike = 0.0) -> None:
        self._link = receivers.link
        self._power = x[..., None, :, 0]
        self._dx = x[..., None, :, 1] - receivers.positions[..., :1]
        self._dy = x[..., None, :, 2] - receivers.positions[..., 1:]
        self._distance = SmoothDiscDistance(
            self._dx**2 + self._dy**2, receivers.edge,
            np.asarray(softening, float)[..., None, None])
        received = self._link.gain(self._distance.squared) * self._power
        self._interference = 1.0 + received[..., 1:].sum(axis=-1)
        self._total = self._interference + received[..., 0]
        rates = np.log1p(received[..., 0] / self._interference)
        self.ground: Array = rates[..., 0]
        self.leaks: Array = rates[..., 1:]

    def derivatives(self) -> 'SlotDerivatives':
        """Return the derivatives of all rates at this x."""
        return SlotDerivatives(self)


class SlotDerivatives:
    """
    The derivatives of the rates of SlotRates.

    A rate is log(1 + S + J) - log(1 + J): the logarithm of the total received power less that of
    interference and noise. By the chain rule, both need only the gain's two derivatives by the
    squared distance and that distance's by the position.

    :ivar gradients: of all rates, r_0 first, (..., N, K, U, 3).
    """

    def __init__(self, rates: SlotRates) -> None:
        self._power, self._dx, self._dy = rates._power, rates._dx, rates._dy
        self._total, self._interference = rates._total, rates._interference
        stretch, bend = rates._distance.derivatives()
        gain, first, second = rates._link.derivatives(rates._distance.squared)
        # The gradient of the gain by position is `_slope` (offset), and its Hessian
        # `_slope` I + `_curvature` (offset)(offset)^T.
        self._slope = 2.0 * first * stretch
        self._curvature = 4.0 * second * stretch**2 - 2.0 * first * bend
        along = self._slope * self._power
        received = np.stack([gain, along * self._dx, along * self._dy], axis=-1)
        self._of_total = received / self._total[..., None, None]
        self._of_interference = received / self._interference[..., None, None]
        self._of_interference[..., 0, :] = 0.0
        self.gradients: Array = self._of_total - self._of_interference

    def hessian(self, weights: Array) -> Array:
        """
        Return the Hessian of the weighted sum of all rates, (..., N, 3 U, 3 U).

        :param weights: of the rates, r_0 first, (..., N, K).
        """
        uavs = self._power.shape[-1]
        weight = np.repeat((weights / self._total)[..., None], uavs, axis=-1)
        weight[..., 1:] -= (weights / self._interference)[..., None]
        mixed = weight * self._slope
        curvature = weight * self._power * self._curvature
        isotropic = (mixed * self._power).sum(axis=-2)
        along_x, along_y = curvature * self._dx, curvature * self._dy
        slots = isotropic.shape[:-1]
        rows = (*slots, weights.shape[-1], 3 * uavs)
        total, interference = self._of_total.reshape(rows), self._of_interference.reshape(rows)
        hessian: Array = (
            np.swapaxes(interference, -1, -2) * weights[..., None, :]) @ interference
        hessian -= (np.swapaxes(total, -1, -2) * weights[..., None, :]) @ total
        block = np.einsum('...ujuk->...ujk', hessian.reshape(*slots, uavs, 3, uavs, 3))
        power_x = (mixed * self._dx).sum(axis=-2)
        power_y = (mixed * self._dy).sum(axis=-2)
        x_y = (along_x * self._dy).sum(axis=-2)
        block[..., 0, 1] += power_x
        block[..., 1, 0] += power_x
        block[..., 0, 2] += power_y
        block[..., 2, 0] += power_y
        block[..., 1, 1] += isotropic + (along_x * self._dx).sum(axis=-2)
        block[..., 2, 2] += isotropic + (along_y * self._dy).sum(axis=-2)
        block[..., 1, 2] += x_y
        block[..., 2, 1] += x_y
        return hessian

    def by_places(self) -> Array:
        """
        Return the derivatives of all gradients by the receivers' places, (..., N, K, 3 U, 2).

        A rate depends on offsets alone, so that a receiver's move is that of all UAVs the other
        way: the sum of the Hessian's columns of their positions, with the sign changed.
        """
        weight = np.repeat((1.0 / self._total)[..., None], self._power.shape[-1], axis=-1)
        weight[..., 1:] -= (1.0 / self._interference)[..., None]
        mixed = weight * self._slope
        curvature = weight * self._power * self._curvature
        offsets = np.stack([self._dx, self._dy], axis=-1)
        by_places = np.empty((*mixed.shape, 3, 2))
        by_places[..., 0, :] = mixed[..., None] * offsets
        by_places[..., 1:, :] = curvature[..., None, None] * (
            offsets[..., :, None] * offsets[..., None, :])
        by_places[..., (1, 2), (0, 1)] += (mixed * self._power)[..., None]
        for part, sign in ((self._of_total, -1.0), (self._of_interference, 1.0)):
            together = part[..., 1:].sum(axis=-2)
            by_places += sign * part[..., None] * together[..., None, None, :]
        return -by_places.reshape(*mixed.shape[:-1], -1, 2)
