"""
Coverage-guided fuzzing of everything that reads a file or the message of a plan.

`python test/fuzz_parsers.py KIND NEW SEEDS -max_total_time=60` changes the seeds of a kind until
something other than an error of the package's tree is raised, a read takes more than 2 s of
processor time or 60 s on the clock, or the process more than 1 GB. The folder NEW keeps inputs
that reach new code. The options are those of libFuzzer. `make fuzz` does so for every kind.
"""

from pathlib import Path
import sys
import tempfile
import time

import atheris

with atheris.instrument_imports(include=['secure_uav_planner', 'pyulog', 'pymavlink']):
    import parsers
    from secure_uav_planner.errors import PlanningError


def main():
    """Fuzz the reader that the command line names."""
    kind = sys.argv.pop(1)
    file = Path(tempfile.mkdtemp(), kind)

    def read(data):
        file.write_bytes(data)
        begin = time.process_time()
        try:
            parsers.READERS[kind](file)
        except PlanningError:
            pass
        took = time.process_time() - begin
        assert took <= 2.0, f'a read took {took:.1f} s of processor time'

    atheris.Setup([sys.argv[0], '-timeout=60', '-rss_limit_mb=1024', *sys.argv[1:]], read)
    atheris.Fuzz()


main()
