"""Track who commands the vehicle. The vehicle always decides; the payload requests, waits, and releases.

down       the wire is closed, or the vehicle is silent
listening  it speaks, and nothing is requested
requested  control was requested
granted    the payload commands
revoked    the vehicle refused, or took control back; it is left alone for a while

No clock, no wire: every call passes the time, and returns what is to be done. Whatever was asked for or held is
given back when it ends on this side; when the vehicle itself ends it there is nothing left to give.
"""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple, TypeAlias

AuthorityState: TypeAlias = Literal["down", "listening", "requested", "granted", "revoked"]

ANSWER_WITHIN_S: Final = (
    10.0  # a request that nobody answers for so long is withdrawn, to be made again: it may have been lost
)
DECIDE_WITHIN_S: Final = (
    120.0  # from a request that is considered to its withdrawal: a person may have to agree; chosen
)
SETTLE_S: Final = (
    1.0  # between giving back and what is said next of control: answers to what was said before are still on their way
)


class Ask(NamedTuple):
    """Request control of the vehicle."""


class GiveBack(NamedTuple):
    """Release control, or withdraw the request for it.

    n_unanswered, n_undecided: requests in a row that nobody answered, or that were considered for too long, if so.
    """

    reason: str
    n_unanswered: int = 0
    n_undecided: int = 0


Action: TypeAlias = Ask | GiveBack


class Authority:
    """Hold the state of control, and decide when to request and to release it.

    silent_after_s: a vehicle not heard for so long is gone. ask_again_s: after a refusal, or control taken back, it is
    asked not sooner. max_control_s: control is given back after so long in one piece. All in seconds; `now_s` never
    runs backwards.
    """

    def __init__(self, *, silent_after_s: float, ask_again_s: float, max_control_s: float) -> None:
        self._silent_after_s = silent_after_s
        self._ask_again_s = ask_again_s
        self._max_control_s = max_control_s
        self._state: AuthorityState = "down"
        self._reason = "the wire is closed"
        self._wire_open = False
        self._heard_s = -math.inf
        self._since_s = -math.inf
        self._not_before_s = -math.inf  # no request sooner
        self._gave_back_s = -math.inf
        self._n_unanswered = 0  # requests, since the vehicle answered one last
        self._n_undecided = 0  # requests, since the vehicle granted or withheld control last
        self._is_considered = False  # the request that was made last
        self._not_asked_for = False  # the vehicle believes that the payload commands, and it does not

    @property
    def state(self) -> AuthorityState:
        return self._state

    @property
    def reason(self) -> str:
        """Return why it is in this state, for people."""
        return self._reason

    def connected(self, now_s: float) -> Action | None:
        """Note that the wire is open. Whether the vehicle is there is known only when it is heard."""
        action = self._lose("the wire was opened anew", now_s)
        self._wire_open = True
        return action

    def disconnected(self, now_s: float) -> Action | None:
        """Note that the wire is closed."""
        action = self._lose("the wire is closed", now_s)
        self._wire_open = False
        return action

    def heard(self, now_s: float) -> None:
        """Note a valid message of the vehicle."""
        if not self._wire_open:
            return
        self._heard_s = now_s
        if self._state == "down":
            self._go("listening", "the vehicle speaks", now_s)

    def granted(self, reason: str, now_s: float) -> None:
        """Take a grant of the vehicle. It counts only if control was requested."""
        if self._state == "requested":
            self._n_unanswered = self._n_undecided = 0
            self._go("granted", reason, now_s)
        elif self._state != "granted":
            self._not_asked_for = True

    def withheld(self, reason: str, now_s: float) -> None:
        """Take a refusal or a revocation of control by the vehicle."""
        self._not_asked_for = False
        if self._state in ("requested", "granted"):
            self._n_unanswered = self._n_undecided = 0
            self._not_before_s = now_s + self._ask_again_s
            self._go("revoked", reason, now_s)

    def considered(self) -> None:
        """Take an answer of the vehicle that it decides later."""
        if self._state == "requested":
            self._n_unanswered, self._is_considered = 0, True

    def give_back(self, reason: str, now_s: float, *, pause: bool) -> Action | None:
        """Release control. pause: it is not requested again at once but as after a refusal."""
        if self._state not in ("requested", "granted"):
            return None
        if pause:
            self._not_before_s = now_s + self._ask_again_s
        return self._give_back("listening", reason, now_s)

    def step(self, wanted: bool, now_s: float) -> Action | None:
        """Return what is to be done now.

        wanted: there is something to command. Called ten times a second.
        """
        if self._state == "down":
            return None
        if now_s - self._heard_s > self._silent_after_s:
            return self._lose(f"the vehicle is silent for {self._silent_after_s:g} s", now_s)
        since_s = now_s - self._since_s
        if self._state == "granted":
            if since_s > self._max_control_s:
                return self.give_back(f"control was held for {self._max_control_s:g} s", now_s, pause=True)
        elif self._state == "requested":
            if self._is_considered and since_s > DECIDE_WITHIN_S:
                self._n_undecided += 1
                withdrawn = self._give_back("listening", f"no decision on the request for {DECIDE_WITHIN_S:g} s", now_s)
                return withdrawn._replace(n_undecided=self._n_undecided)
            if not self._is_considered and since_s > ANSWER_WITHIN_S:
                self._n_unanswered += 1
                withdrawn = self._give_back("listening", f"no answer to the request for {ANSWER_WITHIN_S:g} s", now_s)
                return withdrawn._replace(n_unanswered=self._n_unanswered)
        elif self._state == "revoked" and now_s >= self._not_before_s:
            self._go("listening", "control may be requested again", now_s)
        if self._state in ("requested", "granted"):
            return None if wanted else self.give_back("there is nothing to command", now_s, pause=False)
        if now_s - self._gave_back_s < SETTLE_S:
            return None
        if self._not_asked_for:
            return self._give_back(self._state, "control was not requested", now_s)
        if wanted and self._state == "listening" and now_s >= self._not_before_s:
            self._is_considered = False
            self._go("requested", "control was requested", now_s)
            return Ask()
        return None

    def _lose(self, reason: str, now_s: float) -> Action | None:
        """Note that the vehicle is out of reach; control has to be requested anew."""
        action = None
        if self._state in ("requested", "granted"):
            action = self._give_back("down", reason, now_s)
        self._not_asked_for = False
        self._go("down", reason, now_s)
        return action

    def _give_back(self, state: AuthorityState, reason: str, now_s: float) -> GiveBack:
        self._gave_back_s = now_s
        self._not_asked_for = False
        if state != self._state:
            self._go(state, reason, now_s)
        return GiveBack(reason)

    def _go(self, state: AuthorityState, reason: str, now_s: float) -> None:
        self._state, self._reason, self._since_s = state, reason, now_s
