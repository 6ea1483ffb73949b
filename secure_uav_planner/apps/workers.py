"""Where the tasks of a campaign run: on the cores of this computer, or on a Dask cluster."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
import os
import signal
from typing import Any

from .tasks import empty_row, row_of, Task, WORKER_LOST
from ..errors import name_missing_package, OptionError, PlanningError

THREAD_COUNTS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS',
                 'RAYON_NUM_THREADS')
"""Variables that say how many threads the libraries of a process may have."""

_AHEAD = 4  # Tasks that are handed out for each worker of a cluster.
_PATIENCE = 15.0  # For the scheduler to answer, in s.


class ClusterError(PlanningError, RuntimeError):
    """Workers were lost; what is finished is kept."""

    code = 'cluster'


def on_cores(tasks: Iterable[Task], jobs: int) -> Iterator[dict[str, Any]]:
    """
    Yield the rows of tasks as they are finished.

    :param jobs: processes; -1 for as many as there are cores.
    :raises ClusterError: when a process was killed.
    """
    with name_missing_package():
        import joblib
    with _one_thread_each():
        # The workers inherit that Ctrl-C, which reaches all of a terminal, is for this process.
        handler = _ignore_interrupts()
        try:
            rows = joblib.Parallel(jobs, return_as='generator_unordered', batch_size=1)(
                joblib.delayed(row_of)(task) for task in tasks)
        finally:
            if handler is not None:
                signal.signal(signal.SIGINT, handler)
        try:
            yield from rows
        except RuntimeError as error:
            raise ClusterError(f'a worker process was killed: {str(error).splitlines()[0]}; the '
                               'same command goes on from here') from None
        finally:
            rows.close()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let processes that are started in the meantime have one thread each."""
    before = {name: os.environ.get(name) for name in THREAD_COUNTS}
    os.environ.update(dict.fromkeys(THREAD_COUNTS, '1'))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})


def _ignore_interrupts() -> Any:
    try:
        return signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # Handlers can be set in the main thread only.
        return None


def on_cluster(tasks: Iterable[Task], address: str) -> Iterator[dict[str, Any]]:
    """
    Yield the rows of tasks as they are finished on a Dask cluster.

    A task whose worker dies is given to another; after a few deaths it is a row with that reason.
    The workers need this package.

    :param address: of the scheduler, such as tcp://host:8786.
    :raises MissingPackageError: when Dask is not installed.
    :raises OptionError: when the scheduler does not answer.
    :raises ClusterError: when the scheduler is lost on the way.
    """
    with name_missing_package():
        from distributed import as_completed, Client
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
                if future.status in ('pending', 'lost'):
                    # Its worker died after it had finished it, and another one begins it anew.
                    done.add(future)
                    continue
                task = known.pop(future.key)
                if future.status == 'cancelled':
                    raise ClusterError(lost)
                yield future.result() if future.status == 'finished' else _lost(task, future)
                future.release()
                for new in hand_out(1):
                    done.add(new)
        except OSError:
            raise ClusterError(lost) from None


def _lost(task: Task, future: Any) -> dict[str, Any]:
    """Return the row of a task that no worker survived."""
    return {**empty_row(task), 'outcome': WORKER_LOST, 'reason': str(future.exception())[:500]}
