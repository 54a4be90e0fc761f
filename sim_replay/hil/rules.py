"""State what a scenario expects of a run: a rule each, as written below `expectations`."""

from __future__ import annotations

import re
from typing import Annotated, ClassVar, TypeAlias

import msgspec
from msgspec import Meta

Window: TypeAlias = tuple[float, float]


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Refuse unknown keys."""


class _Rule(Record, frozen=True, kw_only=True, tag_field="is"):
    pass


class _Count(_Rule, frozen=True, kw_only=True):
    """Bound a number; an omitted bound does not limit it. is_count: it is never below 0."""

    is_count: ClassVar[bool] = True
    at_least: float | None = None
    at_most: float | None = None

    def __post_init__(self) -> None:
        if self.at_least is None and self.at_most is None:
            raise ValueError("neither at_least nor at_most is given, so that any number would pass. Give one")
        if self.at_least is not None and self.at_most is None and self.at_least <= 0 and self.is_count:
            raise ValueError(f"at_least {self.at_least:g} is met by any count. Give 1 or more, or at_most")
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            raise ValueError(f"no number is at least {self.at_least:g} and at most {self.at_most:g}")


class ExitCode(_Rule, frozen=True, kw_only=True, tag="exit_code"):
    """Expect this exit code after the request to stop; the service has to end by itself."""

    code: int = 0


class AnswersStop(_Rule, frozen=True, kw_only=True, tag="answers_stop"):
    """Expect the service to announce its stop this soon after the request to stop."""

    within_s: float


class EndsWithin(_Rule, frozen=True, kw_only=True, tag="ends_within"):
    """Expect the service to have ended this soon after the request to stop."""

    within_s: Annotated[float, Meta(gt=0.0)]


class CounterRule(_Count, frozen=True, kw_only=True, tag="counter"):
    """Bound a counter of summary.json, 0 where it is missing.

    name: whole, or with * for any characters: then their sum.
    """

    name: str


class SummaryRule(_Count, frozen=True, kw_only=True, tag="summary"):
    """Bound a number of summary.json, e.g. pings; of one that stands in another, keys from outside in, e.g.
    area.p_detected_mean."""

    is_count: ClassVar[bool] = False
    key: str


class NoticeRule(_Count, frozen=True, kw_only=True, tag="notice"):
    """Count notices of a code that the service raised, in all or between two instants of the run, s after its start."""

    code: str
    between_s: Window | None = None


class LineRule(_Count, frozen=True, kw_only=True, tag="line"):
    """Count lines of the service's output that match a regular expression."""

    matching: str
    between_s: Window | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            re.compile(self.matching)
        except re.error as error:
            raise ValueError(f"'{self.matching}' is not a regular expression: {error}") from error


class SettingsRule(_Count, frozen=True, kw_only=True, tag="settings"):
    """Count changes of a sonar's settings to ones that contain a text."""

    device: str
    containing: str


class DeviceRule(_Count, frozen=True, kw_only=True, tag="device"):
    """Bound a counter of a fake device. device.skipped is 0 only if the computer was fast enough for a valid run."""

    device: str
    counter: str


class Reopened(_Rule, frozen=True, kw_only=True, tag="reopened"):
    """Expect the service to open a device's wire this soon after each time its cable was plugged in again."""

    device: str
    within_s: float


class TargetsFound(_Count, frozen=True, kw_only=True, tag="targets_found"):
    """Count targets of the scene's truth that are found.

    Each has a contact of its own this near, with this probability of a mine.
    """

    within_m: float
    min_p_mine: float


class AsReplayed(_Rule, frozen=True, kw_only=True, tag="as_replayed"):
    """Expect the contacts of a direct replay: as many with min_p_mine or more, each of the same class and this near."""

    within_m: float
    min_p_mine: float
    p_mine_within: float


class JoinedAsTwin(_Rule, frozen=True, kw_only=True, tag="joined_as_twin"):
    """Expect the joined replay of the session to be that of its undisturbed twin, to the byte.

    The twin is one chain that was never stopped and was given what each start's decoders made of the bytes on the disk.
    Also every announced contact has to be in the journal, and every start to have gone on with the session.
    """


class AnnouncedOnce(_Rule, frozen=True, kw_only=True, tag="announced_once"):
    """Expect contacts.jsonl to hold no contact twice for the same event, as after a kill, and one or more in all."""


class StoredAsAnnounced(_Rule, frozen=True, kw_only=True, tag="stored_as_announced"):
    """Expect contacts.geojson to hold each contact as contacts.jsonl has it last, and no other.

    One or more have to be announced, before the last of `restarts_s` where there are any.
    """


class ContactTimes(_Rule, frozen=True, kw_only=True, tag="contact_times"):
    """Expect the UTC of each contact in contacts.geojson to lie in the run, or this near; there must be one or more."""

    within_s: Annotated[float, Meta(ge=0.0)] = 1.0


class RecordedWhole(_Rule, frozen=True, kw_only=True, tag="recorded_whole"):
    """Expect the recording to hold as many bytes of a port as came in over its link, and more than 0.

    Of an slcan adapter frames are recorded, not bytes; a start that was killed leaves no count.
    """

    port: str


class FreshHealth(_Rule, frozen=True, kw_only=True, tag="fresh_health"):
    """Expect the time that health.json states to be this near to the service's end."""

    within_s: Annotated[float, Meta(gt=0.0)]


class Watched(_Rule, frozen=True, kw_only=True, tag="watched"):
    """Expect the service to report to its manager that it is ready and stops, and signs of life in between."""

    watchdog_s: Annotated[float, Meta(gt=0.0)]


class Restarted(_Rule, frozen=True, kw_only=True, tag="restarted"):
    """Expect the service to be ready this soon after each of `restarts_s`, with so little of its recording lost.

    lost_s: from the last byte recorded to the kill.
    """

    ready_within_s: Annotated[float, Meta(gt=0.0)]
    lost_s: Annotated[float, Meta(gt=0.0)] = 1.0


class Steady(_Rule, frozen=True, kw_only=True, tag="steady"):
    """Expect memory and open files of service and perception not to grow by more than a share of them over the run.

    Growth is what all starts have in common; it is judged by the lower end of its 95 % interval.
    """

    share: Annotated[float, Meta(gt=0.0)] = 0.1


class ReportRule(_Count, frozen=True, kw_only=True, tag="reported"):
    """Count a fake device's reports, in all or between two instants of the run. containing: in its details, as JSON."""

    device: str
    what: str
    containing: str = ""
    between_s: Window | None = None


class ReportedInTime(_Rule, frozen=True, kw_only=True, tag="told_in_time"):
    """Expect every contact announced with min_p_mine or more to reach a vehicle this soon.

    It is reported as it is or has become by then.

    There must be one or more.
    """

    device: str
    within_s: float
    min_p_mine: float


class Passed(_Count, frozen=True, kw_only=True, tag="passed"):
    """Count targets passed on a straight run under the payload's command, at a ground range from..to.

    other_look_deg: minimum difference of the look angle from every pass before.
    """

    device: str
    ground_range_m: Window
    other_look_deg: float = 0.0


class Sharper(_Count, frozen=True, kw_only=True, tag="sharper"):
    """Count contacts that a vehicle received with one view first and more last, then nearer to the truth.

    That is a higher p_mine at a target of the scene, a lower one elsewhere. If one at a target got lower, none counts.
    """

    device: str


class InsideFence(_Rule, frozen=True, kw_only=True, tag="inside_fence"):
    """Expect every commanded place, and the vehicle while commanded, to lie inside the fence of `service.vehicle`.

    It has to be commanded once or more.
    """

    device: str


class AboveFloor(_Rule, frozen=True, kw_only=True, tag="above_floor"):
    """Expect every commanded depth and altitude to lie this high over the true sea floor below the vehicle.

    It has to be commanded once or more.
    """

    device: str
    min_altitude_m: Annotated[float, Meta(gt=0.0)]


class OwnPlanAtEnd(_Rule, frozen=True, kw_only=True, tag="own_plan_at_end"):
    """Expect no command to the vehicle in the last seconds of the run."""

    device: str
    last_s: Annotated[float, Meta(gt=0.0)] = 2.5


class Silence(_Rule, frozen=True, kw_only=True, tag="own_plan_after_kill"):
    """Expect a vehicle to leave the last command this soon after the service's kill.

    It flies its own plan until the end.
    """

    device: str
    within_s: float


class LeftAlone(_Rule, frozen=True, kw_only=True, tag="left_alone"):
    """Expect no grant and no command from a person's stop of a vehicle until it flies a plan of its own again.

    It has to be stopped, by the faults `abort` or `stop_plan`, and to be commanded again after the last stop.
    """

    device: str


class ReportedAsStored(_Rule, frozen=True, kw_only=True, tag="reported_as_stored"):
    """Expect the last report of each contact to a vehicle to say what contacts.geojson says.

    Every contact with min_p_mine or more is reported, there must be one or more, and early contacts are taken back.
    """

    device: str
    min_p_mine: float


class SameCount(_Rule, frozen=True, kw_only=True, tag="same_count"):
    """Expect a counter of summary.json to be that of a fake device, which saw the same on its side, and more than 0."""

    name: str
    device: str
    counter: str


Counted: TypeAlias = (
    CounterRule
    | SummaryRule
    | NoticeRule
    | LineRule
    | SettingsRule
    | DeviceRule
    | TargetsFound
    | ReportRule
    | Passed
    | Sharper
)
VehicleRule: TypeAlias = (
    ReportRule
    | ReportedInTime
    | ReportedAsStored
    | Passed
    | Sharper
    | InsideFence
    | AboveFloor
    | OwnPlanAtEnd
    | Silence
    | LeftAlone
)
OfDevice: TypeAlias = SettingsRule | DeviceRule | Reopened | SameCount | VehicleRule
Rule: TypeAlias = (
    Counted
    | ExitCode
    | AnswersStop
    | EndsWithin
    | Reopened
    | AsReplayed
    | JoinedAsTwin
    | AnnouncedOnce
    | StoredAsAnnounced
    | ContactTimes
    | RecordedWhole
    | FreshHealth
    | Watched
    | Restarted
    | Steady
    | SameCount
    | ReportedInTime
    | ReportedAsStored
    | InsideFence
    | AboveFloor
    | OwnPlanAtEnd
    | Silence
    | LeftAlone
)


class Expectation(Record, frozen=True, kw_only=True):
    """State one expectation. test: what is examined, in words. expected: what has to hold."""

    test: Annotated[str, Meta(min_length=1)]
    expected: Rule
