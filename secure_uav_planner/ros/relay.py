"""The executable `relay`; the node is in relay_node."""

from functools import partial

from .start import run_executable

main = partial(run_executable, 'relay')

if __name__ == '__main__':
    main()
