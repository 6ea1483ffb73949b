"""Texts for people, in one line of limited length."""

LONGEST_FRAME = 255
"""The most characters of a frame_id; a path carries it once for every point."""

_MOST = 400


def brief(text: object, most: int = _MOST) -> str:
    """Return a text, such as an error, in one line; of a long text the middle is cut out."""
    line = ' '.join(str(text).split())
    if len(line) <= most:
        return line
    half = (most - 5) // 2
    return f'{line[:half]} ... {line[-half:]}'


def with_type(error: BaseException) -> str:
    """Return the class and the text of an unexpected error in one line."""
    return brief(f'{type(error).__name__}: {error}')
