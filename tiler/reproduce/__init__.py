"""The papers' tables and figures, computed anew: published beside measured. `tiler reproduce` is the command.

One package a paper, one module an item; `catalog` finds them, `run` runs them, `page` and `write` tell the result.
"""
