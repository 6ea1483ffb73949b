"""The search for multipliers: columns, branches and temperatures around Newton's method."""

from __future__ import annotations

import numpy as np

from .columns import about, Columns, grid
from .conjugate import Array, entropy, sigmoid, transmit_power
from .dual import Branch, Dual, Point
from .multipliers import Multipliers
from .team import Team

NODES = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)


class Search:
    def __init__(self, team, positions, powers, order=2, along=11, across=13, log=None):
        self.team, self.log = team, log or (lambda *a: None)
        self.p = 2 if order == 1 else 5
        e, g, u = team.eavesdroppers, len(team.stages.count), len(team.lenses)
        middle = (team.stages.first + team.stages.last) // 2
        lenses = team.lenses
        local = [lens.local(positions[i, middle]) for i, lens in enumerate(lenses)]
        power = np.maximum(powers[:, middle - 1], 0)
        on = power[0] > 1e-3 * lenses[0].average
        guess = power.copy()
        if on.any():
            near = np.where(on)[0][np.abs(np.arange(g)[:, None] - np.where(on)[0]).argmin(1)]
            guess[:, ~on] = power[:, near[~on]]
        else:
            guess[:] = np.array([lens.average for lens in lenses])[:, None]
        logs = [lens.log_squares(q) for lens, q in zip(lenses, local)]
        heard0 = [np.exp(lens.log_gain - a) for lens, (a, b) in zip(lenses, logs)]
        heard = [np.exp(lens.log_gain - b) for lens, (a, b) in zip(lenses, logs)]
        noise0 = 1 + sum((h * q for h, q in zip(heard0[1:], guess[1:])), np.zeros(g))
        noise = 1 + sum((h * q[:, None] for h, q in zip(heard[1:], guess[1:])), np.zeros((g, e)))
        z0 = np.log(np.maximum(heard0[0] * guess[0] / noise0, 1e-9))
        ze = np.log(np.maximum(heard[0] * guess[0][:, None] / noise, 1e-9))
        self.weight = np.clip(sigmoid(z0), 0.3, 1 - 1e-6)
        slope = (sigmoid(z0) - sigmoid(ze.max(-1))) / np.maximum(power[0], 1e-9)
        lam = np.full(u, 1e-5)
        lam[0] = max(np.median(slope[on]), 1e-6) if on.any() else 1e-2
        nominal = lam[0] * np.clip(guess[0], 0.1 * lenses[0].average, None)
        s = np.clip(np.minimum(sigmoid(ze.max(-1)), self.weight - nominal), 0.05,
                    self.weight * (1 - 1e-7))
        share = np.exp(8 * (ze - ze.max(-1, keepdims=True)))
        share = share / share.sum(-1, keepdims=True) + 0.02
        share /= share.sum(-1, keepdims=True)
        self.point = Point(np.zeros((g + 1, u, self.p)), (s[:, None] * share)[None], lam)
        self.weights = [self.weight]
        self.tables, self.places, self.base = [], [], []
        self.extra = [None] * u
        for i, lens in enumerate(lenses):
            places = np.concatenate([grid(lens, along, across), about(lens, local[i])], 1)
            if lens.transmits:
                table = Columns.of(lens, places, np.zeros(places.shape[:2]), 1)
                few = grid(lens, 5, 5)
                base = Columns.of(lens, few, np.zeros(few.shape[:2]), 1)
            else:
                star = np.clip(guess[i], 1e-6, lens.peak)[:, None]
                levels = np.minimum(np.concatenate([
                    np.zeros((g, 1)), star * np.exp(np.linspace(-1.2, 1.2, 7)),
                    np.broadcast_to(lens.peak * np.geomspace(1e-4, 1, 5), (g, 5))], 1), lens.peak)
                table = self._times(lens, places, levels)
                base = self._times(lens, grid(lens, 4, 5), np.concatenate([0 * star, star], 1))
            still = np.concatenate([lens.rim(32), grid(lens, 7, 9), about(lens, local[i])], 1)
            self.tables.append(table)
            self.base.append(base)
            self.places.append(Columns.of(lens, still, np.zeros(still.shape[:2]),
                                          max(team.jammers, 1)))

    def _times(self, lens, places, levels):
        shape = places.shape[:2] + levels.shape[1:]
        place = np.broadcast_to(places[:, :, None], shape + (2,)).reshape(len(places), -1, 2)
        power = np.broadcast_to(levels[:, None], shape).reshape(len(places), -1)
        return Columns.of(lens, place, power, self.team.jammers)

    def branches(self):
        u, g = len(self.team.lenses), len(self.weight)
        out = []
        for k, w in enumerate(self.weights):
            theta, rho = np.ones((u, g)), np.ones(u)
            out.append(Branch(w, k, theta, rho))
        return out

    def potential(self, i, place):
        dual = Dual(self.team, [], [], [], 1e-9)
        return dual._potential(i, self.point, place, False)[0]

    def price(self, keep, refine=2):
        """The best columns of every UAV for the present multipliers."""
        branches = self.branches()
        out = []
        for i, lens in enumerate(self.team.lenses):
            pool = self.tables[i] if self.extra[i] is None else self.tables[i].joined(self.extra[i])
            potential = self.potential(i, pool.place)
            chosen = []
            news = []
            for b in branches:
                w, v = b.weight * b.theta[i], self.point.shares[b.shares] * b.rho[i]
                value = potential + pool.value(w, v, self.point.prices[i])
                few = min(keep, value.shape[1])
                top = np.argpartition(value, -few, axis=1)[:, -few:]
                chosen.append(pool.take(top))
                if refine:
                    value = np.take_along_axis(value, top, 1)
                    best = np.argsort(-value, axis=1)[:, :4]
                    news.append(self._refined(i, lens, chosen[-1].take(best), w, v, refine))
            if news:
                self.extra[i] = news[0] if len(news) == 1 else news[0].joined(news[1])
                chosen += news
            columns = chosen[0]
            for c in chosen[1:] + [self.base[i]]:
                columns = columns.joined(c)
            out.append(columns)
        return out

    def _refined(self, i, lens, cols, w, v, rounds):
        """Compass search from the given columns."""
        g, c = cols.power.shape
        low, high = lens.sides
        h = ((high - low).max(1) / 12)[:, None] * np.ones((1, c))
        ratio = np.full((g, c), 0.4)
        place, power = cols.place, cols.power
        stage = np.arange(g)[:, None, None]
        moves = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]] + (
            [] if lens.transmits else [[0, 0, 1], [0, 0, -1]]), float)
        for _ in range(rounds * 4):
            new = place[:, :, None] + h[..., None, None] * moves[:, :2]
            ok = lens.inside(new, stage)
            new = np.where(ok[..., None], new, place[:, :, None])
            p = np.minimum(power[..., None] * np.exp(ratio[..., None] * moves[:, 2]), lens.peak)
            flat = Columns.of(lens, new.reshape(g, -1, 2), p.reshape(g, -1), max(self.team.jammers, 1))
            value = (self.potential(i, flat.place) + flat.value(w, v, self.point.prices[i])).reshape(
                g, c, -1)
            pick = value.argmax(-1)[..., None]
            place = np.take_along_axis(new, pick[..., None], 2)[:, :, 0]
            power = np.take_along_axis(p, pick, 2)[..., 0]
            stay = pick[..., 0] == 0
            h = np.where(stay, h / 2.5, h)
            ratio = np.where(stay, ratio / 2.5, ratio)
        return Columns.of(lens, place, power, max(self.team.jammers, 1))

    def still_places(self, keep):
        out = []
        for i in range(len(self.team.lenses)):
            value = self.potential(i, self.places[i].place)
            value = np.broadcast_to(value, self.places[i].power.shape)
            few = min(keep, value.shape[1])
            out.append(self.places[i].take(np.argpartition(value, -few, axis=1)[:, -few:]))
        return out

    def run(self, taus=(0.3, 0.1, 0.03, 0.01, 0.003), rounds=(1, 2, 3, 3, 3), iterations=8, keep=70):
        self.evaluations = 0
        for tau, repeats in zip(taus, rounds):
            for _ in range(repeats):
                columns = self.price(keep)
                places = self.places if self.p == 2 else self.still_places(40)
                dual = Dual(self.team, columns, places, self.branches(), tau)
                self.minimise(dual, iterations)
                self.columns = columns
                f = dual.evaluate(self.point, False)[0]
            n = self.team.stages.slots
            self.log(f'tau {tau:g} smoothed {f / n / np.log(2):.5f} evaluations {self.evaluations}')

    def minimise(self, dual, iterations):
        point = self.point
        n = dual.count.sum()
        for _ in range(iterations):
            f, _, _, newton = dual.evaluate(point)
            self.evaluations += 1
            for damping in (1e-9, 1e-6, 1e-3):
                try:
                    step = newton.step(damping)
                    break
                except np.linalg.LinAlgError:
                    continue
            else:
                break
            slope = newton.slope(step)
            if -slope < 1e-3 * dual.tau * n**0.5:
                break
            weights = np.array([next(b.weight for b in dual.branches if b.shares == k)
                                for k in range(len(point.shares))])
            with np.errstate(all='ignore'):
                dv, v = step.shares, point.shares
                total = -dv.sum(-1)
                room = np.minimum(np.where(dv < 0, -v / dv, np.inf).min(-1),
                                  np.where(total < 0, -(weights - v.sum(-1)) / total, np.inf))
                dv = dv * np.minimum(1, 0.9 * room)[..., None]
                dl = step.prices
                dl = dl * np.minimum(1, 0.9 * np.where(dl < 0, -point.prices / dl, np.inf))
            step = Point(step.potentials, dv, dl)
            clipped = newton.slope(step)
            slope = min(slope, 0) if clipped >= 0 else clipped
            t = 1.0
            for _ in range(12):
                trial = point.moved(step, t)
                fn = dual.evaluate(trial, False)[0]
                if fn <= f + 1e-4 * t * slope:
                    break
                t *= 0.4
            else:
                break
            point = trial
        self.point = point

    def multipliers(self):
        team, point = self.team, self.point
        g, e, u = len(self.weight), team.eavesdroppers, len(team.lenses)
        weights = np.sort(np.stack([np.full(g, x) for x in NODES] + self.weights), axis=0)
        near = self.columns
        potential = [self.potential(i, near[i].place) for i in range(u)]
        shares = np.array([self.node_shares(w, near, potential) for w in weights])
        known = np.array([[(potential[i] + near[i].value(w, v, point.prices[i])).max(1)
                           for w, v in zip(weights, shares)] for i in range(u)])
        slope = point.potentials[..., :2].transpose(1, 0, 2)
        bend = (np.zeros(slope.shape[:2] + (3,)) if self.p == 2
                else point.potentials[..., 2:].transpose(1, 0, 2))
        still = np.array([np.broadcast_to(self.potential(i, self.places[i].place),
                                          self.places[i].power.shape).max(1) for i in range(u)])
        return Multipliers(slope, bend, point.prices, weights, shares,
                           np.ones((len(weights), 1, g, max(team.jammers, 1))),
                           np.ones((1, max(team.jammers, 1))), known[:, :, None], still)

    def node_shares(self, w, near, potential):
        """Golden section in the direction of the point's v."""
        point, team = self.point, self.team
        direction = point.shares[0] / point.shares[0].sum(-1, keepdims=True)
        fixed = [potential[i] + near[i].value(w, 0 * direction, point.prices[i]) for i in range(len(near))]
        slopes = [np.matmul(c.leaks, direction[..., None])[..., 0] for c in near]

        def value(s):
            y = -entropy(s) + transmit_power(w - s, point.prices[0], team.lenses[0].peak)[0]
            for f, k in zip(fixed, slopes):
                y = y + (f + s[:, None] * k).max(1)
            return y
        gold = (np.sqrt(5) - 1) / 2
        lo, hi = 0 * w, w
        x1, x2 = hi - gold * (hi - lo), lo + gold * (hi - lo)
        f1, f2 = value(x1), value(x2)
        for _ in range(20):
            left = f1 < f2
            lo, hi = np.where(left, lo, x1), np.where(left, x2, hi)
            new = np.where(left, hi - gold * (hi - lo), lo + gold * (hi - lo))
            f = value(new)
            x1, x2, f1, f2 = (np.where(left, new, x2), np.where(left, x1, new),
                              np.where(left, f, f2), np.where(left, f1, f))
        return ((lo + hi) / 2)[:, None] * direction
