"""Sathe 2011, View Frustum Culling of Catmull-Clark Patches in DirectX 11."""

ITEMS: tuple[str, ...] = ()
