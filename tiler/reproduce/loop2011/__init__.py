"""Loop, Nießner, Eisenacher 2011, Effective Back-Patch Culling for Hardware Tessellation."""

ITEMS: tuple[str, ...] = ()
