"""Timelines: a frame on its simulated cores, tile by tile and patch by patch, as a file for Perfetto."""
