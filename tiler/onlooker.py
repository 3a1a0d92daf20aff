"""Onlookers: who wants to see a frame's batches and its render target, and changes nothing. The machine only shows them."""

from typing import Protocol

from pipeline.types import I32, I64, U8
from tiler.back_end import Bins
from tiler.front_end import Geometry
from tiler.tile import Target
from tiler.units import Units


class Onlooker(Protocol):
    """Sees every pass of every batch when its tiles are worked off, then the end of the frame."""

    def see(
        self, number: int, phase: int, bins: Bins, batch: I32, units: Units, geometry: Geometry, order: I64
    ) -> None:
        """Pass `number` of a batch of units, in phase 0 or 1 of the frame. order : submit numbers of its triangles."""

    def end(self, units: Units, shaded: U8, target: Target) -> None:
        """After all passes. shaded : uint8, 1 for each queue entry, pass by pass, whose unit its tile shaded; of no rows in
        `triangle` binning. target : holds submit numbers.
        """
