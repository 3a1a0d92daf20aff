"""What no paper shows: patch and sub-patch binning against triangle binning and the ideal."""

ITEMS = (
    "table_1",
    "figure_factor",
    "figure_tile",
    "figure_depth",
    "figure_feedback",
    "table_break_even",
)
