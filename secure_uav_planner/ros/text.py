"""Texts for people: one line of bounded length."""

_MOST = 400


def brief(text: object, most: int = _MOST) -> str:
    """Return a text, such as that of an error, in one line; the middle of a long one is cut."""
    line = ' '.join(str(text).split())
    if len(line) <= most:
        return line
    half = (most - 5) // 2
    return f'{line[:half]} ... {line[-half:]}'


def with_type(error: BaseException) -> str:
    """Return an unexpected error's class and text in one line."""
    return brief(f'{type(error).__name__}: {error}')
