"""What Direct3D 11 defines, one module a stage, in the order data flows: patch in, window-space triangles out.

Knows nothing of tiles: the machine around these stages is the package `tiler`, which imports this one and never the
other way round.
"""
