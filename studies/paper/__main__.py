"""
The study: the paper's Figures 2 and 3, further figures, and a check of the paper's claims.

It is a campaign: each finished point is kept in the output folder, and a study that was stopped
continues from there.
"""

import argparse
import pathlib
import signal
import sys

from secure_uav_planner.apps.results import save_tables
from secure_uav_planner.apps.tasks import plan_path
from secure_uav_planner.errors import OptionError, PlanningError

from .claims import write_claims
from .experiments import load_plans, make_points, plan_points
from .figures import write_figures


def main(argv=None):
    """Run the study; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=pathlib.Path, default=pathlib.Path('out/study'),
                        help='folder for figures, tables and finished plans')
    parser.add_argument('--jobs', type=int, default=-1, help='processes, -1 for all cores')
    parser.add_argument('--scheduler', help='a Dask scheduler, whose workers are used instead; '
                        'as for `secure_uav_planner sweep`')
    parser.add_argument('--quick', action='store_true', help='only a few points of each figure')
    options = parser.parse_args(argv)
    points = make_points(options.quick)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        rows = plan_points(points, options.out, options.jobs, options.scheduler)
        written = save_tables(rows, options.out)
        if failed := [row for row in rows if row['outcome'] != 'ok']:
            print(f'study: {len(failed)} of {len(rows)} points failed, so there are no figures; '
                  f'{written[0]} has the reasons, such as: {failed[0]["reason"]}',
                  file=sys.stderr)
            return 1
        plans = load_plans(points, options.out)
        claims, table = write_claims(plans, options.out / 'claims.md')
        written += [*write_figures(plans, options.out, table), claims]
    except KeyboardInterrupt:
        kept = sum(plan_path(options.out, point.task['key']).exists() for point in points)
        print(f'\nstopped: {kept} of {len(points)} points are kept, the same command goes on '
              'from there', file=sys.stderr)
        return 130
    except (OSError, PlanningError) as error:
        print(f'study: {error}', file=sys.stderr)
        return 2 if isinstance(error, OptionError) else 1
    print('\n'.join(map(str, written)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
