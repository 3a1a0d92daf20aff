"""A scheduler in this process and two workers under nannies; tells address and process ids, and ends with its input."""

import asyncio
import json
import logging
import sys
import tempfile


async def main(folder: str) -> None:
    import dask
    from distributed import Nanny, Scheduler

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    dask.config.set({"distributed.worker.daemon": True})
    async with (
        Scheduler(host="127.0.0.1", port=0, dashboard=False) as scheduler,
        Nanny(scheduler.address, nthreads=1, dashboard=False, local_directory=folder) as one,
        Nanny(scheduler.address, nthreads=1, dashboard=False, local_directory=folder) as two,
    ):
        print(json.dumps({"address": scheduler.address, "workers": [one.pid, two.pid]}), flush=True)
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(main(folder))
