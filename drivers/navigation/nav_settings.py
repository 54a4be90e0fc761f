"""Configure how the navigation units are merged, and which one has priority."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from auv_mcm.settings.port_settings import NavUnitSettings


class NavMergeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configure all units, by the names that their fixes carry.

    The units of one bus share the settings of the bus unless they have their own.
    """

    units: dict[str, NavUnitSettings]
    max_speed_mps: Annotated[
        float, Meta(gt=0.0, le=30.0, description="a fix that implies a higher speed is rejected, m/s")
    ] = 6.0
    recover_s: Annotated[
        float, Meta(ge=0.0, le=600.0, description="a better unit serves again after being healthy this long, s")
    ] = 5.0
    surface_depth_m: Annotated[
        float, Meta(gt=0.0, le=20.0, description="deeper than this, satellite positions are rejected, m")
    ] = 1.0

    def unit(self, source: str) -> NavUnitSettings | None:
        """Return the settings of a source: its own, else those of its bus, which is named before the dot."""
        return self.units.get(source) or self.units.get(source.partition(".")[0])
