"""Words that several views have in common."""


def receiver_label(eavesdropper):
    """Return the advantage of an Eavesdropper's receiver, such as '+6 dB', '' without one."""
    advantage = eavesdropper.receiver_advantage_db
    return f'{advantage:+g} dB' if advantage else ''
