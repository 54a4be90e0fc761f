"""How the navigation units are merged, and which one wins."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from auv_mcm.settings.port_settings import NavUnitSettings


class NavMergeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All units, by the names that their fixes carry; the units of one bus share the settings of the bus unless they have their own."""

    units: dict[str, NavUnitSettings]
    max_speed_mps: Annotated[float, Meta(gt=0.0, le=30.0, description="no fix is believed that needs more than this, m/s")] = 6.0
    recover_s: Annotated[float, Meta(ge=0.0, le=600.0, description="a better unit serves again after being healthy this long, s")] = 5.0
    surface_depth_m: Annotated[float, Meta(gt=0.0, le=20.0, description="deeper than this no satellite receiver is believed, m")] = 1.0

    def unit(self, source: str) -> NavUnitSettings | None:
        """Settings of a source: its own, else its bus's, which is named before the dot."""
        return self.units.get(source) or self.units.get(source.partition(".")[0])
