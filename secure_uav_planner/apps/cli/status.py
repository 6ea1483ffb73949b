"""What the exit statuses mean."""

DONE, FAILED, BAD_INPUT, STOPPED = 0, 1, 2, 130

STATUSES = {
    DONE: 'done',
    FAILED: 'failed on the way, for example because the disk is full',
    BAD_INPUT: 'bad input: a wrong option, mission or plan, or a folder that cannot be written',
    STOPPED: 'stopped by Ctrl-C; a plan that was under way is kept as far as it had come',
}
"""The meaning of each exit status."""
