"""The executable `planner`; the node is in planner_node."""

from functools import partial

from .start import run_executable

main = partial(run_executable, 'planner', pause=0.005)

if __name__ == '__main__':
    main()
