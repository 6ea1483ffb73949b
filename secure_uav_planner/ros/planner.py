"""The executable `planner`; the node is in planner_node."""

from .start import run_executable

_PAUSE = 0.005


def main(args: list[str] | None = None) -> None:
    """Run the planner node as a process."""
    run_executable('planner_node', 'Planner', args, pause=_PAUSE)


if __name__ == '__main__':
    main()
