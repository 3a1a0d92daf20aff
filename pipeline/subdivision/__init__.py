"""Catmull-Clark control meshes to patches: topology, masks, refinement, and the hull shader's control-point phase."""
