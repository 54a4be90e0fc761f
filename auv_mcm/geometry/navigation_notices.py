"""Word the notices about navigation as a whole, so that live and replayed missions report the same."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Final

from auv_mcm.geometry.navigation_checks import ZERO_ALTITUDES
from auv_mcm.records import Notice

_MAX_STEPS_REPORTED: Final = 10  # of a mission; further jumps are only counted (chosen)


class NavNotices:
    """Hold notices until they are taken; all but those of steps are raised once."""

    def __init__(self, raised: set[str]) -> None:
        """raised: codes of notices that are not raised again; grows."""
        self._raised = raised
        self._notices: list[Notice] = []

    def take(self) -> list[Notice]:
        """Take the notices since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def speed_off_track(self, by_track_m: float, measured_m: float, time_s: float) -> None:
        """Report a way by the measured speed that is not the way by positions, m; time_s: since 1970, as below."""
        text = (
            f"the measured speed makes {measured_m:.0f} m where positions moved {by_track_m:.0f} m: along-track scale "
            "and coverage come from the positions. Check the speed's source and its unit (knots or m/s)."
        )
        if measured_m == 0.0:
            text = (
                f"speed is 0 while positions moved {by_track_m:.0f} m: along-track scale and coverage come from the "
                "positions. Check that the speed is logged and its sensor works."
            )
        self._raise_once("navigation.speed_off_track", text, time_s)

    def fixes_sparse(self, hole_s: float, limit_s: float, time_s: float) -> None:
        """Report holes between fixes that nothing bridges, longer than the limit of interpolation; s."""
        text = (
            f"positions come as far as {hole_s:.1f} s apart, and heading and speed do not bridge the time between: "
            f"nothing there counts as covered. Record heading and speed, or raise navigation.max_gap_s ({limit_s:g} s) "
            "if the track is straight."
        )
        self._raise_once("navigation.fixes_sparse", text, time_s)

    def altitude_zero(self, time_s: float) -> None:
        """Report an altitude that stays 0."""
        text = (
            f"altitude was 0 in {ZERO_ALTITUDES} samples in a row and is taken as unknown: the sea floor is found "
            "from the echoes alone. Check that the altimeter is connected, logged, and has bottom lock."
        )
        self._raise_once("navigation.altitude_zero", text, time_s)

    def position_disputed(self, doubt_m: float, time_s: float) -> None:
        """Report fixes at two places, of which none is known to be right."""
        text = (
            f"fixes give two places {doubt_m:.0f} m apart again and again: which one is right is not "
            "known. Contacts there carry that distance as their sigma and nothing there counts as covered. Check "
            "the navigation units and their cables."
        )
        self._raise_once("navigation.position_disputed", text, time_s)

    def positions_rejected(self, n_rejected: int, n_decided: int, time_s: float) -> None:
        """Report that many of the newest fixes were rejected."""
        text = (
            f"{n_rejected} of the last {n_decided} positions were rejected: they do not exist on Earth, "
            "or the vehicle cannot have moved there and back. Check the navigation unit, its antenna and its "
            "cable. Further ones are only counted."
        )
        self._raise_once("navigation.positions_rejected", text, time_s)

    def position_jump(self, step_m: float, n_steps: int, time_s: float) -> None:
        """Report a step of the track to another place; n_steps: with it."""
        if n_steps > _MAX_STEPS_REPORTED:
            return
        text = (
            f"the position jumped by {step_m:.0f} m and stays there: the new place is used from now on. Find out which "
            "place is right: contacts on one side of the jump may be wrong by as much."
        )
        text += " Further jumps are only counted." * (n_steps == _MAX_STEPS_REPORTED)
        self._notices.append(Notice(code="nav_position_jump", text=text, place=_utc(time_s)))

    def heading_zero(self, course_deg: float, time_s: float) -> None:
        """Report a heading of 0 in every sample on another course."""
        text = (
            f"heading is 0 in every sample while the vehicle makes good a course of {course_deg % 360.0:.0f} "
            "degrees: it is taken as unknown, and the course is used. Check that a compass is connected and "
            "logged."
        )
        self._raise_once("navigation.heading_zero", text, time_s)

    def heading_off_course(self, offset_rad: float, time_s: float) -> None:
        """Report a heading that is steadily off the course; positive to the right."""
        side = "right" if offset_rad > 0.0 else "left"
        text = (
            f"heading is {abs(math.degrees(offset_rad)):.0f} degrees {side} of the course made good, steadily: "
            "contacts lie on the wrong side if the compass is wrong. Check its mounting, its heading offset and "
            "sign, and whether port and starboard are swapped."
        )
        self._raise_once("navigation.heading_off_course", text, time_s)

    def _raise_once(self, code: str, text: str, time_s: float) -> None:
        if code not in self._raised:
            self._raised.add(code)
            self._notices.append(Notice(code=code, text=text, place=_utc(time_s)))


def _utc(time_s: float) -> str:
    """Write the instant for messages."""
    try:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (OverflowError, ValueError, OSError):
        return f"time {time_s:g} s"
