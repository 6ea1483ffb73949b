"""The executable `relay`; the node is in relay_node."""

from .start import run


def main(args: list[str] | None = None) -> None:
    """Run the relay node as a process."""
    run('relay_node', 'Relay', args)


if __name__ == '__main__':
    main()
