"""Clarabel by way of CVXPY: each problem has a solver of its own, and a failure is no error."""

import clarabel
import cvxpy as cp
import pytest
from secure_uav_planner import fly_hover_fly, Scenario, solve
from secure_uav_planner.optimize.alternating import restrict_trajectories, solve_problem


class PanicException(BaseException):
    """As pyo3 names what becomes of a panic in Rust; no module exports the original."""


def small_problem():
    x = cp.Variable(2)
    return cp.Problem(cp.Minimize(cp.norm(x)), [x >= 1])


def make_failing_solver(error, after=0):
    """Return a replacement of Clarabel's solver that fails after a number of calls."""
    healthy, calls = clarabel.DefaultSolver, []

    def solver(*arguments):
        calls.append(arguments)
        if len(calls) > after:
            raise error
        return healthy(*arguments)

    return solver


@pytest.mark.parametrize('error', [
    Exception('Data formatting error'), ValueError('NaN'), cp.SolverError('no luck'),
    PanicException('index out of bounds'), MemoryError()])
def test_every_exception_of_the_solver_is_a_failure(monkeypatch, error):
    monkeypatch.setattr(clarabel, 'DefaultSolver', make_failing_solver(error))
    assert solve_problem(small_problem()) == (False, 0.0)


def test_a_panic_or_an_error_of_clarabel_itself_is_a_failure(monkeypatch):
    # Clarabel 0.10 panics when the cones do not fit the matrix, 0.11 raises a plain Exception.
    healthy = clarabel.DefaultSolver
    monkeypatch.setattr(clarabel, 'DefaultSolver', lambda p, q, a, b, cones, settings: healthy(
        p, q, a, b, [*cones, clarabel.NonnegativeConeT(3)], settings))
    assert solve_problem(small_problem()) == (False, 0.0)


@pytest.mark.parametrize('stop', [KeyboardInterrupt, SystemExit])
def test_a_request_to_stop_the_program_is_passed_on(monkeypatch, stop):
    monkeypatch.setattr(clarabel, 'DefaultSolver', make_failing_solver(stop()))
    with pytest.raises(stop):
        solve_problem(small_problem())


@pytest.mark.parametrize('time_left', [-1.0, 0.0, 1e-9])
def test_without_time_left_nothing_is_solved(monkeypatch, time_left):
    # Not even started, since compiling counts against the deadline.
    monkeypatch.setattr(clarabel, 'DefaultSolver', None)
    assert solve_problem(small_problem(), time_left)[:2] == (False, 0.0)


def test_the_solver_stops_at_the_deadline():
    scenario = Scenario.paper(200, slots=3000)
    start = fly_hover_fly(scenario)
    restriction = restrict_trajectories(scenario, start.positions, start.powers)
    assert not solve_problem(restriction.problem, time_left=0.01)[0]


def test_a_problem_that_is_not_convex_is_an_error_in_the_program():
    x = cp.Variable()
    with pytest.raises(cp.DCPError):
        solve_problem(cp.Problem(cp.Maximize(cp.square(x)), [x <= 1]))


def make_hasty_settings(after):
    """Return a replacement of Clarabel's settings that give up at once after a number of calls."""
    healthy, calls = clarabel.DefaultSettings, []

    def settings():
        calls.append(healthy())
        calls[-1].max_iter = 1 if len(calls) > after else 200
        return calls[-1]

    return settings


@pytest.mark.parametrize('name, failing', [
    ('DefaultSolver', make_failing_solver(Exception('Data formatting error'), after=5)),
    ('DefaultSolver', make_failing_solver(PanicException('index out of bounds'), after=5)),
    ('DefaultSettings', make_hasty_settings(after=5))])
def test_the_best_iterate_survives_every_failure_of_the_solver(monkeypatch, name, failing):
    monkeypatch.setattr(clarabel, name, failing)
    plan = solve(Scenario.paper(102), method='alternating')
    assert plan.status == 'numerical_trouble'
    rates = [iteration.rate for iteration in plan.history
             if iteration.step in ('power', 'trajectory')]
    assert plan.guaranteed_rate == pytest.approx(rates[4])
    assert rates[4] > max(rates[0], 0.7)


def test_every_solve_has_a_solver_of_its_own(monkeypatch):
    # CVXPY's warm start does not survive that other entries of the matrices are zero.
    healthy, made = clarabel.DefaultSolver, []
    monkeypatch.setattr(
        clarabel, 'DefaultSolver', lambda *given: made.append(given) or healthy(*given))
    problem = small_problem()
    for _ in range(3):
        assert solve_problem(problem)[0]
    assert len(made) == 3
