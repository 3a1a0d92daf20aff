"""The explorer: a local page in which one turns the camera and the machine, and looks into tiles (docs/explorer.md).

`requests` says what the page may ask for, `session` draws it on a thread of its own, `tile_queue` and `patch_boxes` look into
the frame, `reply` packs what comes out, `server` serves it to this computer alone. Nothing here is known to the machine.
"""
