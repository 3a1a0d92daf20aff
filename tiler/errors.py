"""The one error that users see for bad input; everything else is a bug of ours."""


class TilerError(ValueError):
    """Bad input or an impossible request. The message names the field, the value and what is allowed."""
