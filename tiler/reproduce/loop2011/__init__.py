"""Loop, Nießner, Eisenacher 2011, Effective Back-Patch Culling for Hardware Tessellation."""

ITEMS = ("table_1", "figure_1", "figure_2", "degenerate")
