"""Reports: one HTML file that shows a frame, machines side by side, or a study, and needs nothing beside it (docs/report.md).

`collect` and `collect_study` gather plain data and arrays, `encode` makes text of them, `page` puts text, style and script
into one file, `write` is the door. Nothing here is known to the machine.
"""
