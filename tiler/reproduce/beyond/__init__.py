"""What no paper shows: patch and sub-patch binning against triangle binning and the ideal."""

ITEMS: tuple[str, ...] = ()
