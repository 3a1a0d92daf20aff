"""`python -m tiler.study.worker`: runs rows that come as JSON lines on standard input, and answers on standard output.

It ends when its input ends, at once and whatever it is at: a parent that was killed leaves no process behind. What a
library prints goes to standard error, so that it cannot be taken for an answer.
"""

import json
import os
import queue
import sys
import threading
from typing import Any


def main() -> None:
    """Read, run, answer; never returns normally."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    asked: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(asked,), daemon=True).start()

    from tiler.config import Machine
    from tiler.shared import Shared
    from tiler.study.rows import RowRunner, sources
    from tiler.warmup import warm_up

    threads = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    runner = RowRunner(threads)
    _answer(answers, {"ready": sources()})
    while True:
        message = asked.get()
        if "warm" in message:
            warm_up([Machine(**fields) for fields in message["warm"]], Shared())
            _answer(answers, {"warm": True})
        else:
            _answer(answers, runner.run(message))


def _listen(asked: "queue.SimpleQueue[dict[str, Any]]") -> None:
    for line in sys.stdin:
        asked.put(json.loads(line))
    os._exit(0)


def _answer(answers: Any, value: dict[str, Any]) -> None:
    try:
        answers.write(json.dumps(value) + "\n")
    except OSError:  # nobody listens any more
        os._exit(0)


if __name__ == "__main__":
    main()
