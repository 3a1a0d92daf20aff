"""`tiler warmup` and `tiler doctor`: the installation."""

import sys


def warmup() -> None:
    """Compile all kernels now and keep them on disk, so that the first frame does not wait for it."""
    import time

    from tiler.warmup import warm_up

    start = time.monotonic()
    warm_up()
    print(f"kernels are ready ({time.monotonic() - start:.1f} s)")


def doctor() -> None:
    """Check this installation: versions, the kernel cache, the scenes, and packages that overwrite ours."""
    from tiler.doctor import diagnose

    report, healthy = diagnose()
    print(report)
    if not healthy:
        sys.exit(1)
