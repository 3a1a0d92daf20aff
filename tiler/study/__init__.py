"""Studies: the machine over a grid of scenes, views, frames and machines; every finished row is on disk.

schema      a study file, or the arguments of `tiler.sweep`, becomes a plan
settings    what of a scene a study may set         views     where its eyes stand
grid        the rows, counted and numbered, not built
rows        one row by its description: what every engine runs
ledger      the results file: one long SQLite table
local, workers, cluster    the engines: this process, processes of this machine, a Dask cluster
run         `tiler.sweep`                            results   `tiler.load_study`
export, plots    CSV, Parquet, a line of matplotlib
"""
