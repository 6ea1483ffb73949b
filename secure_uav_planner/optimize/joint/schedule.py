"""The tuned numbers that several modules of the joint method share."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """The tuned numbers of Newton's method and of problem (P1); multistart.py has its own."""

    # Barrier parameters that end the coarse grid and the full grid.
    coarse_mu: float = 1e-3
    final_mu: float = 1e-8
    # The least with which a finer grid begins where limits keep interpolation from being centred.
    refined_mu: float = 0.03
    steps: int = 150  # The most Newton steps on one grid.
    try_every: int = 16  # Steps between proposals, which take as long as a few to a hundred steps.

    # A plan that is improved further: how far it is moved into the interior, and where mu begins.
    warm_share: float = 0.01
    warm_mu: float = 1e-3

    # (P1), by the exchange of worst places: the leak, in nats, by which a place must be worse to
    # count; mu at the beginning and end, and the most steps at the end; the gain that is worth a
    # second round, and its most steps.
    worse: float = 1e-7
    places_mu: float = 0.02
    places_final_mu: float = 1e-7
    places_patience: int = 8
    places_worth: float = 0.01
    places_steps: int = 40

    # Newton's method. The fraction to the boundary, and the factor by which a power may change.
    boundary: float = 0.995
    power_factor: float = 10.0
    # The line search: trials that stop every variable at its own limit, and further trials that
    # go along the step.
    clipped_trials: int = 3
    uniform_trials: int = 17
    softening: float = 0.3  # Rounding of the kink above an eavesdropper, in sqrt(mu).
    dual_range: float = 1e4  # How far a dual may leave its central value, as a factor.
    # Linear and superlinear decrease of mu, kappa_mu and theta_mu of IPOPT, and when: the Newton
    # decrement for each UAV, and the most steps for one mu.
    mu_factor: float = 0.2
    mu_power: float = 1.5
    centred: float = 0.5
    patience: int = 15


SCHEDULE = Schedule()
"""What the joint method uses unless it is told otherwise."""
