"""Words that several views have in common."""


def receiver_label(eavesdropper):
    """Return the advantage of an Eavesdropper's receiver, such as '+6 dB', '' without one."""
    advantage = eavesdropper.receiver_advantage_db
    return f'{advantage:+g} dB' if advantage else ''


def energy_label(energy):
    """Return an Energy in words, such as '29.3 kJ (hovering 15.7)', '' for None."""
    return '' if energy is None else (
        f'{energy.total / 1e3:.3g} kJ (hovering {energy.hovering / 1e3:.3g})')
