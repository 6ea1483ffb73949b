"""Where the tasks of a campaign run: on the cores of this computer, or on a Dask cluster."""

from collections.abc import Iterable, Iterator
from itertools import islice
import os
import signal
from typing import Any

from .evaluation import row_of
from ..errors import OptionError, PlanningError

THREAD_COUNTS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS',
                 'RAYON_NUM_THREADS')
"""Variables that say how many threads the libraries of a process may have."""

_AHEAD = 4  # Tasks that are handed out for each worker of a cluster.
_PATIENCE = 15.0  # For the scheduler to answer, in s.


class ClusterError(PlanningError, RuntimeError):
    """Workers were lost; what is finished is kept."""

    code = 'cluster'


def on_cores(tasks: Iterable[dict[str, Any]], jobs: int) -> Iterator[dict[str, Any]]:
    """
    Yield the rows of tasks as they are finished.

    :param jobs: processes; -1 for as many as there are cores.
    :raises ClusterError: when a process was killed.
    """
    import joblib
    # The workers inherit both settings: each has one thread, and Ctrl-C is for this process.
    os.environ.update(dict.fromkeys(THREAD_COUNTS, '1'))
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        rows = joblib.Parallel(jobs, return_as='generator_unordered', batch_size=1)(
            joblib.delayed(row_of)(task) for task in tasks)
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        yield from rows
    except RuntimeError as error:
        raise ClusterError(f'a worker process was killed: {str(error).splitlines()[0]}; the same '
                           'command goes on from here') from None
    finally:
        rows.close()


def on_cluster(tasks: Iterable[dict[str, Any]], address: str) -> Iterator[dict[str, Any]]:
    """
    Yield the rows of tasks as they are finished on a Dask cluster.

    A task whose worker dies is given to another; after a few deaths it is a row with that reason.
    The workers need this package.

    :param address: of the scheduler, such as tcp://host:8786.
    :raises OptionError: when Dask is not installed, or the scheduler does not answer.
    :raises ClusterError: when the scheduler is lost on the way.
    """
    try:
        from distributed import as_completed, Client
    except ModuleNotFoundError as error:
        raise OptionError(f'{error.name} is not installed; pip install '
                          '"secure_uav_planner[campaign]"') from None
    try:
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError, TimeoutError) as error:
        raise OptionError(f'the scheduler {address} cannot be reached: {error}') from None
    with client:
        waiting = iter(tasks)
        known = {}

        def hand_out(count: int) -> list[Any]:
            futures = []
            for task in islice(waiting, count):
                # A scheduler may still be forgetting the tasks of a driver that was killed.
                future = client.submit(
                    row_of, task, key=f'mission-{task["key"]}-{client.id}', pure=False)
                known[future.key] = task
                futures.append(future)
            return futures

        lost = f'the scheduler {address} is lost; the same command goes on from here'
        try:
            done = as_completed(hand_out(_AHEAD * max(1, sum(client.nthreads().values()))))
            for future in done:
                task = known.pop(future.key)
                if future.status == 'cancelled':
                    raise ClusterError(lost)
                yield future.result() if future.status == 'finished' else _lost(task, future)
                future.release()
                for new in hand_out(1):
                    done.add(new)
        except OSError:
            raise ClusterError(lost) from None


def _lost(task: dict[str, Any], future: Any) -> dict[str, Any]:
    """Return the row of a task that no worker survived."""
    return {**{name: task[name] for name in ('key', 'sample', 'method', 'objective', 'fields')},
            'outcome': 'worker_lost', 'reason': str(future.exception())[:500]}
