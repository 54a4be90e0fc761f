"""Call contacts mines while the false alarms expected among them may stay within what the operator accepts."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.classify.beliefs import most_believed
from auv_mcm.contacts.background import LEVELS_NATS, LOWEST_NATS, BackgroundPrior, expected_background
from auv_mcm.contacts.contact import is_mine_like
from auv_mcm.contacts.expected_alarms import MINE_LIKE_NATS, ExpectedAlarms, called_from_nats, expected_alarms, is_short
from auv_mcm.contacts.seen_area import SeenArea
from auv_mcm.detect.belief import odds_of
from auv_mcm.records import NAN, Contact, CoveragePatch, Notice, contact_number
from auv_mcm.settings.config import ContactsConfig

# of contacts or area, after which the background is estimated anew: about 150 estimates in a mission
_GROWTH: Final = 0.1
# by which the level must have passed a contact for its call to be announced again: a bin of log-odds
_TURNED_NATS: Final = 0.25
_UNLIKE_SIGMAS: Final = 6.0  # of training missions: of 19 simulated and recorded missions left out the highest has 3.8
_UNLIKE_P_MINE: Final = (0.05, 0.2)

_UNKNOWN: Final = 0  # what was announced of a contact, one byte each: nothing yet
_NOT_CALLED: Final = 1  # announced as not called
_CALLED: Final = 2  # announced as called


class OperatingPoint(NamedTuple):
    """Hold what is accepted, and the false alarms that a mission's contacts make expect so far.

    asked_per_km2: false alarms accepted. n_contacts, area_km2: what they are expected from. expected: None where
    p_mine is not calibrated, as without confirmation. level_nats: lowest log-odds called, those of p_mine 0.2 where
    nothing is expected.
    """

    asked_per_km2: float
    n_contacts: int
    area_km2: float
    expected: ExpectedAlarms | None
    level_nats: float = MINE_LIKE_NATS

    @property
    def is_short(self) -> bool:
        """Check whether the area searched allows fewer than one false alarm."""
        return self.expected is not None and is_short(self.area_km2, self.asked_per_km2)

    def calls(self, contact: Contact) -> bool:
        """Decide whether a contact is called a mine."""
        return odds_of(contact.p_mine) >= self.level_nats

    def marked(self, contact: Contact) -> Contact:
        """Copy a contact with the density of false alarms as mine-like as it, and its call.

        One that is called is of the likeliest kind of mine, whatever its p_mine: a mine is no clutter.
        """
        called = self.calls(contact)
        is_mine = called or is_mine_like(contact)
        density, interval = NAN, (NAN, NAN)
        if self.expected is not None:
            expected = self.expected.reaching(odds_of(contact.p_mine))
            density, interval = expected.per_km2, (expected.low, expected.high)
        return msgspec.structs.replace(
            contact,
            classification=contact.mine_kind if is_mine else most_believed(contact.belief),
            false_alarms_per_km2=density,
            false_alarms_95_per_km2=interval,
            called=called,
        )


class MarkedContacts:
    """Mark contacts one at a time as they are gone through, again and again."""

    def __init__(self, contacts: Iterable[Contact], point: OperatingPoint) -> None:
        self._contacts = contacts
        self._point = point

    def __iter__(self) -> Iterator[Contact]:
        return map(self._point.marked, self._contacts)


class CallWatch:
    """Follow a mission's contacts and area, keep the estimate of its background, and choose which contacts to announce.

    Uses nothing but what came before. Memory: 9 bytes per contact.
    """

    def __init__(self, config: ContactsConfig, prior: BackgroundPrior | None) -> None:
        """Start with an empty mission.

        prior: of the log-odds of the detector that serves; None where there is none.
        """
        self._asked_per_km2 = config.false_alarms_per_km2
        self._prior = prior
        self._area = SeenArea()
        self._log_odds = array("d")  # by number of the contact, NaN of those never reported
        self._announced = bytearray()
        self._n_changed = 0
        self._point: OperatingPoint | None = None
        self._notices: list[Notice] = []
        self._is_unlike = False

    @property
    def point(self) -> OperatingPoint:
        """Return the operating point as it was estimated last."""
        return self._point or self._estimated()

    def cover(self, patch: CoveragePatch) -> None:
        """Add sea floor that was searched."""
        self._area.add(patch)

    def announce(
        self, changed: Sequence[Contact], read: Callable[[Sequence[int]], Iterable[Contact]], *, is_last: bool = False
    ) -> list[Contact]:
        """Mark contacts that are new or changed, and add those whose call has turned since it was announced.

        All by number.

        Parameters
        ----------
        read
            Gives contacts by number.
        is_last
            Nothing follows, so that the background is estimated from everything and every call that differs from the
            last one announced is announced.
        """
        for contact in changed:
            self._learn(contact_number(contact.id), odds_of(contact.p_mine))
        if is_last or self._is_due():
            self._point = self._estimated()
            turned = set(self._turned(0.0 if is_last else _TURNED_NATS))
        else:
            turned = set()
        turned -= {contact_number(contact.id) for contact in changed}
        announced = [self.point.marked(contact) for contact in (*changed, *read(sorted(turned)))]
        for contact in announced:
            self._announced[contact_number(contact.id)] = _CALLED if contact.called else _NOT_CALLED
        return sorted(announced, key=lambda contact: contact_number(contact.id))

    def take_notices(self) -> list[Notice]:
        """Return the notices raised since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _learn(self, number: int, nats: float) -> None:
        if number >= len(self._log_odds):
            missing = number + 1 - len(self._log_odds)
            self._log_odds.extend([math.nan] * missing)
            self._announced.extend(bytes(missing))
        self._log_odds[number] = nats
        self._n_changed += 1

    def _is_due(self) -> bool:
        before = self._point
        if before is None:
            return True
        return self._n_changed > _GROWTH * before.n_contacts or self._area.km2 > (1.0 + _GROWTH) * before.area_km2

    def _estimated(self) -> OperatingPoint:
        self._n_changed = 0
        asked, area_km2, log_odds = self._asked_per_km2, self._area.km2, np.array(self._log_odds)
        n_contacts = int(np.count_nonzero(log_odds >= LOWEST_NATS))
        if self._prior is None:
            return OperatingPoint(asked, n_contacts, area_km2, None)
        expected = expected_alarms(log_odds, area_km2)
        self._compare(expected, self._prior)
        return OperatingPoint(asked, n_contacts, area_km2, expected, called_from_nats(log_odds, area_km2, asked))

    def _turned(self, margin_nats: float) -> list[int]:
        level, values = self.point.level_nats, np.array(self._log_odds)
        announced = np.frombuffer(bytes(self._announced), dtype=np.uint8)
        is_called = (announced == _NOT_CALLED) & (values >= level + margin_nats)
        is_dropped = (announced == _CALLED) & (values < level - margin_nats)
        return np.flatnonzero(is_called | is_dropped).tolist()

    def _compare(self, seen: ExpectedAlarms, prior: BackgroundPrior) -> None:
        """Report once that far more false alarms are expected than on any sea floor of the training set."""
        usual, spread = expected_background(prior)
        for p_mine in _UNLIKE_P_MINE:
            at, alarms = int(np.searchsorted(LEVELS_NATS, odds_of(p_mine))), seen.reaching(odds_of(p_mine))
            if not self._is_unlike and alarms.low > math.exp(usual[at] + _UNLIKE_SIGMAS * spread[at]):
                self._is_unlike = True
                self._notices.append(_unlike(p_mine, alarms.per_km2, math.exp(usual[at])))


def _unlike(p_mine: float, per_km2: float, usual_per_km2: float) -> Notice:
    return Notice(
        code="contacts.background_unlike",
        text=f"about {per_km2:.2g} contacts per km² reach p_mine {p_mine:g} but are probably not mines; "
        f"{usual_per_km2:.2g} do on the sea floors of the training set. The sea floor or the recorder is unlike all of "
        "those, and p_mine may be wrong. Look at the pictures of some contacts; check sonar.transfer, sonar.full_scale "
        "and the gain; go by 'called' rather than by p_mine.",
    )
