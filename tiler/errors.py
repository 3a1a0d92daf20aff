"""The one error that users see for bad input; everything else is a bug of ours."""

from collections.abc import Iterable


class TilerError(ValueError):
    """Bad input or an impossible request. The message names the field, the value and what is allowed."""


class TilerWarning(UserWarning):
    """Something in the input that has a defined result, and that the user may not have meant."""


def unknown_name(name: str, known: Iterable[str]) -> str:
    """`allowed: ...`, preceded by the likeliest of the known names where one is close."""
    from difflib import get_close_matches

    known = list(known)
    close = get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}allowed: {', '.join(known) if known else 'none'}"
