"""Put on PYTHONPATH by the tests of studies: what TILER_TEST_ROW names does harm to the process that runs it.

TILER_TEST_ROW=77:kill ends the process at row 77, each time; 77:once only the first time (a file says that it was done).
"""

import importlib.util
import os
import sys
from pathlib import Path

ROW, _, HARM = os.environ.get("TILER_TEST_ROW", "").partition(":")


class Finder:
    def find_spec(self, name, path=None, target=None):
        if name != "tiler.study.rows":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            run = module.RowRunner.run

            def harmful(self, job):
                if str(job["row"]) == ROW and (HARM == "kill" or not Path(HARM).exists()):
                    if HARM != "kill":
                        Path(HARM).touch()
                    os.kill(os.getpid(), 9)
                return run(self, job)

            module.RowRunner.run = harmful

        spec.loader.exec_module = exec_module
        return spec


if ROW:
    sys.meta_path.insert(0, Finder())
