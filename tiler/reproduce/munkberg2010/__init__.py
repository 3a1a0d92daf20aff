"""Munkberg, Hasselgren, Toth, Akenine-Möller 2010, Efficient Bounding of Displaced Bézier Patches."""

ITEMS = (
    "table_1",
    "figure_6",
    "figure_7",
    "figure_8",
    "figure_9",
    "figure_10",
    "table_2",
    "figure_11",
)
