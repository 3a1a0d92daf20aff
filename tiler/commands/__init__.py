"""The commands of `tiler`, a module for each or for a few of a kind.

Each parses its options, calls what any program could call, and prints. Heavy modules are imported inside of the
commands: `tiler --help` must not wait for them.
"""
