"""Measurements in seconds: stages, scaling, start-up, and side by side with Mesa's llvmpipe. The command is `tiler bench`.

Nothing here is part of the machine, and the machine knows nothing of it: stages are timed from outside (`stopwatch`).
Seconds depend on the computer and on who shares it, so every result carries the host's facts, its load before and after,
and the time of a fixed loop of Python run beside it (`facts.spin`).
"""
