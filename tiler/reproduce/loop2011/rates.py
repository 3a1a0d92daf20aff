"""The paper's tests of one model from many eyes: what does not depend on the eye is made once."""

from typing import NamedTuple

import numpy as np

from pipeline.culling import apex, control_planes, ncone, tcone
from pipeline.culling.backface import BACK
from pipeline.culling.offset import Offsets
from pipeline.types import B1, F64, Patches
from tiler.host import Host
from tiler.reproduce.loop2011.models import TESTS

CHUNK = 250  # eyes at a time


class Prepared(NamedTuple):
    """Cones and control planes of all patches, world space."""

    patches: Patches
    tcone: apex.Cones
    ncone: apex.Cones
    planes: control_planes.Planes


def prepare(patches: Patches) -> Prepared:
    """Everything of undisplaced patches that no eye changes."""
    n = len(patches.control_points)
    everyone, still = np.arange(n), Offsets(np.ones(n, np.bool_), np.zeros((n, 2)))
    return Prepared(
        patches,
        tcone.make_cones(patches, everyone, still),
        ncone.make_cones(patches, everyone, still),
        control_planes.make_planes(patches, everyone),
    )


def culled(prepared: Prepared, eyes: F64) -> dict[str, B1]:
    """Whether each test culls each patch for each eye: bool[patches, eyes], by test."""
    return {
        "tcone": apex.face_eyes(prepared.tcone, eyes) == BACK,
        "ncone": apex.face_eyes(prepared.ncone, eyes) == BACK,
        "tangent_plane": control_planes.face_eyes(prepared.planes, prepared.patches, eyes) == BACK,
    }


class Rates(NamedTuple):
    """Of many eyes."""

    culled: dict[str, F64]  # per cent of the patches culled for each eye, (eyes,), by test
    alone: dict[str, int]  # (patch, eye) culled by a cone and not by the tangent plane, by cone


def rates(prepared: Prepared, eyes: F64, threads: int | None) -> Rates:
    """Per cent of patches that each test culls for each of the eyes."""
    found = {name: np.empty(len(eyes)) for name in TESTS}
    chunks = [(first, min(first + CHUNK, len(eyes))) for first in range(0, len(eyes), CHUNK)]
    alone = {name: np.zeros(len(chunks), np.int64) for name in TESTS[:2]}

    def work(c: int) -> None:
        first, end = chunks[c]
        answers = culled(prepared, eyes[first:end])
        for name, answer in answers.items():
            found[name][first:end] = 100.0 * answer.mean(axis=0)
        for name, counts in alone.items():
            counts[c] = np.count_nonzero(answers[name] & ~answers["tangent_plane"])

    with Host(threads or 1) as host:
        host.run(work, len(chunks))
    return Rates(found, {name: int(counts.sum()) for name, counts in alone.items()})
