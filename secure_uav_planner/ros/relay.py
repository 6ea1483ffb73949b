"""The executable `relay`; the node is in relay_node."""

from .start import run_executable


def main(args: list[str] | None = None) -> None:
    """Run the relay node as a process."""
    run_executable('relay_node', 'Relay', args)


if __name__ == '__main__':
    main()
