"""The guaranteed rate of a slot with its exact gradient and Hessian, for all slots at once."""

from dataclasses import dataclass

import numpy as np

_TINY = 1e-30


@dataclass(frozen=True, eq=False)
class SlotModel:
    """
    What a slot's rates depend on, in units that make every number moderate.

    Variables are x = (power, x, y) of every UAV, an array (..., U, 3): powers in units of the
    UAV's average power, places in units of `length` around the ground node. Receivers are the
    ground node (0) and the eavesdroppers (1..E), K = E + 1 in all.

    :param length: the unit of length in m.
    :param power: the unit of power of each UAV, (U,) in W.
    :param origin: the place of the ground node, (2,) in m.
    :param places: of the receivers, (K, 2).
    :param edge: eps that the guarantee adds to a distance, or subtracts from it, (K, U).
    :param squared_heights: H^2, (U,).
    :param gains: SNR at unit distance and unit power, (U,).
    """

    length: float
    power: np.ndarray
    origin: np.ndarray
    places: np.ndarray
    edge: np.ndarray
    squared_heights: np.ndarray
    gains: np.ndarray

    @classmethod
    def of(cls, scenario):
        """Return the model of a Scenario."""
        heights = np.array([uav.altitude for uav in scenario.uavs])
        length = float(np.exp(np.log(heights).mean()))
        power = np.array([uav.average_power for uav in scenario.uavs])
        origin = np.array(scenario.ground_node)
        receivers = [scenario.ground_node] + [eve.position for eve in scenario.eavesdroppers]
        radii = np.array([0.0] + [eve.error_radius for eve in scenario.eavesdroppers])
        edge = np.repeat(radii[:, None], len(power), axis=1) / length
        edge[:, 0] *= -1
        return cls(length, power, origin, (np.array(receivers) - origin) / length, edge,
                   (heights / length)**2, scenario.reference_snr * power / length**2)

    def variables(self, positions, powers):
        """Return x (..., N, U, 3) of positions (..., U, N, 2) in m and powers (..., U, N) in W."""
        scaled = np.concatenate([(powers / self.power[:, None])[..., None],
                                 (positions - self.origin) / self.length], axis=-1)
        return np.moveaxis(scaled, -3, -2)

    def positions(self, x):
        """Return places (..., U, N, 2) in m of x (..., N, U, 3)."""
        return np.moveaxis(x[..., 1:], -2, -3) * self.length + self.origin

    def powers(self, x):
        """Return watts (..., U, N) of x (..., N, U, 3)."""
        return np.moveaxis(x[..., 0], -1, -2) * self.power[:, None]


class Slots:
    """
    The rates at one x in nats, and their derivatives on request.

    The kink of (d + eps)^2 at d = 0 is rounded: d becomes sqrt(d^2 + softening^2), which only
    lowers the guaranteed rate.

    :param model: a SlotModel.
    :param x: (..., N, U, 3).
    :param softening: of the jammers' distances, a number or an array of shape (..., 1).
    """

    def __init__(self, model, x, softening=0.0):
        self._model = model
        self._power = x[..., None, :, 0]
        self._dx = x[..., None, :, 1] - model.places[:, :1]
        self._dy = x[..., None, :, 2] - model.places[:, 1:]
        squared = self._dx**2 + self._dy**2
        soft = np.asarray(softening)[..., None, None]**2 * (model.edge > 0)
        self._distance = np.sqrt(squared + (soft + _TINY))
        self._inside = self._distance <= -model.edge
        cleared = squared + model.edge * (2 * self._distance + model.edge)
        # The edge of the transmitter is negative: (d - eps)^2 = d^2 - 2 eps d + eps^2.
        self._denominator = model.squared_heights + np.where(self._inside, 0.0, cleared)
        self._gain = model.gains / self._denominator
        received = self._gain * self._power
        self._jammed = 1.0 + received[..., 1:].sum(axis=-1)
        self._heard = self._jammed + received[..., 0]
        rates = np.log1p(received[..., 0] / self._jammed)
        self.ground = rates[..., 0]
        """r_0 of every slot, (..., N)."""
        self.leaks = rates[..., 1:]
        """r_e to every eavesdropper, (..., N, E)."""

    def first_derivatives(self):
        """
        Return the gradients of all rates, r_0 first, (..., N, K, U, 3).

        They are differences of those of log(1 + S + J) and of log(1 + J), which are kept.
        """
        model = self._model
        inside, denominator = self._inside, self._denominator
        self._slope = np.where(inside, 0.0, 1.0 + model.edge / self._distance) / denominator
        # Of the received power: by power, and by place along the offset.
        self._by_place = -2.0 * self._gain * self._slope
        along = self._by_place * self._power
        gradient = np.stack([self._gain, along * self._dx, along * self._dy], axis=-1)
        self._of_heard = gradient / self._heard[..., None, None]
        self._of_jammed = gradient / self._jammed[..., None, None]
        self._of_jammed[..., 0, :] = 0.0
        return self._of_heard - self._of_jammed

    def second_derivative(self, weights):
        """
        Return the Hessian of the weighted sum of all rates, (..., N, 3 U, 3 U).

        To be called after first_derivatives.

        :param weights: of the rates, r_0 first, (..., N, K).
        """
        model = self._model
        bend = np.where(self._inside, 0.0, model.edge / self._distance**3) / self._denominator
        curvature = self._gain * (2.0 * bend + 8.0 * self._slope**2)
        weight = np.repeat((weights / self._heard)[..., None], len(model.gains), axis=-1)
        weight[..., 1:] -= (weights / self._jammed)[..., None]
        first = weight * self._by_place
        second = weight * self._power * curvature
        flat = (weight * self._by_place * self._power).sum(axis=-2)
        by_x, by_y = second * self._dx, second * self._dy
        users = len(model.gains)
        shape = flat.shape[:-1]
        stacked = (*shape, weights.shape[-1], 3 * users)
        heard = self._of_heard.reshape(stacked)
        jammed = self._of_jammed.reshape(stacked)
        hessian = (np.swapaxes(jammed, -1, -2) * weights[..., None, :]) @ jammed
        hessian -= (np.swapaxes(heard, -1, -2) * weights[..., None, :]) @ heard
        block = np.einsum('...ujuk->...ujk', hessian.reshape(*shape, users, 3, users, 3))
        power_x = (first * self._dx).sum(axis=-2)
        power_y = (first * self._dy).sum(axis=-2)
        x_y = (by_x * self._dy).sum(axis=-2)
        block[..., 0, 1] += power_x
        block[..., 1, 0] += power_x
        block[..., 0, 2] += power_y
        block[..., 2, 0] += power_y
        block[..., 1, 1] += flat + (by_x * self._dx).sum(axis=-2)
        block[..., 2, 2] += flat + (by_y * self._dy).sum(axis=-2)
        block[..., 1, 2] += x_y
        block[..., 2, 1] += x_y
        return hessian
