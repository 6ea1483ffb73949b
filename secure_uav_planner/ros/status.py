"""What the planner says of itself: levels as diagnostics use them, and a value for everything."""

from diagnostic_msgs.msg import DiagnosticStatus

from .scenarios import GROUND_NODE_TOPIC, pose_topic

REASONS = {
    'converged': 'converged',
    'iteration_limit': 'stopped at the iteration limit',
    'time_limit': 'stopped at time_limit with the best feasible plan so far',
    'numerical_trouble': 'a step of the solver failed, the best feasible plan is kept',
}
"""What the status of a published plan means to a person."""


def summary(plan):
    """Return a plan in one line, without any place in it."""
    return (f'{plan.method} plan of {plan.scenario.slots} slots: guaranteed rate '
            f'{plan.guaranteed_rate:.4f}, worst-case rate {plan.worst_case_rate:.4f} bit/s/Hz, '
            f'{plan.solve_time:.2f} s, {_iterations(plan)} iterations, '
            f'{REASONS[plan.status]}')


def level_and_text(outcome, poses, progress):
    """
    Return the level of the whole and why.

    ERROR: a solve failed. WARN: there is no way to plan now, or the last answer was not the best
    there can be. STALE: a pose is too old to plan with. OK: none of these.

    :param outcome: level and text of the last request or replan.
    :param poses: every PoseProblem there is.
    :param progress: the latest Iteration of a solve under way, or None.
    """
    level, text = outcome
    if progress is not None:
        return DiagnosticStatus.OK, (f'solving: iteration {progress.number}, guaranteed rate '
                                     f'{progress.rate:.4f} bit/s/Hz')
    if level == DiagnosticStatus.OK and poses:
        stale = all(problem.stale for problem in poses)
        return (DiagnosticStatus.STALE if stale else DiagnosticStatus.WARN,
                '; '.join(problem.text for problem in poses))
    return level, text


def values(plan, progress, busy, poses, parameters, counts, now):
    """Return the values of the status by key; see level_and_text for the parameters."""
    found = {'state': 'solving' if busy else 'idle', **counts}
    if progress is not None:
        found.update({
            'progress.iteration': progress.number, 'progress.step': progress.step,
            'progress.guaranteed_rate': progress.rate,
            'progress.elapsed': progress.elapsed})
    if plan is not None:
        found.update({
            'plan.stamp': f'{plan.start_ns * 1e-9:.9f}',
            'plan.age': now - plan.start_ns * 1e-9,
            'plan.guaranteed_rate': plan.guaranteed_rate,
            'plan.worst_case_rate': plan.worst_case_rate,
            'plan.method': plan.method, 'plan.status': plan.status,
            'plan.iterations': _iterations(plan), 'plan.solve_time': plan.solve_time})
    names = parameters['eavesdroppers'] + parameters['uavs']
    for topic in [GROUND_NODE_TOPIC, *map(pose_topic, names)]:
        known = poses.get(topic)
        found[f'pose_age.{topic}'] = 'none' if known is None else known.age(now)
    return found


def _iterations(plan):
    return max(0, len(plan.history) - 1)  # the first is the start
