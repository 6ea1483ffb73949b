"""The executable `replay`; the node is in replay_node."""

from functools import partial

from .start import run_executable

main = partial(run_executable, 'replay')

if __name__ == '__main__':
    main()
