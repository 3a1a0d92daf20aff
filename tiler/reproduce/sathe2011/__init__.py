"""Sathe 2011, View Frustum Culling of Catmull-Clark Patches in DirectX 11."""

ITEMS = ("figure_6", "figure_7", "figure_8", "figure_9")
