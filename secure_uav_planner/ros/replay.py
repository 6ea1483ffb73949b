"""The executable `replay`; the node is in replay_node."""

from .start import run_executable


def main(args: list[str] | None = None) -> None:
    """Run the replay node as a process."""
    run_executable('replay_node', 'Replay', args)


if __name__ == '__main__':
    main()
