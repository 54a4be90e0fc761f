"""Translate between dialect records and the messages on a CAN bus."""

from __future__ import annotations

import math
from typing import Final

from drivers.vehicle.can_messages import CLASSES, REFERENCES, GoToMessage, HealthText, ReportMessage, SteerMessage
from drivers.vehicle.dialect import Command, ContactReport, GoTo, Steer, Vertical
from drivers.vehicle.wire_steps import shallower, slower

TEXT_BYTES: Final = 44  # of a text message: 7 parts of 6 bytes and one of 2
_TEXT_PART_BYTES: Final = (6, 6, 6, 6, 6, 6, 6, 2)  # bytes of each field of a text message
_TURN: Final = 2.0 * math.pi
_SESSION_BITS: Final = 32  # of a session's number on the bus
_MAX_SIZE_M: Final = 65.53  # m: the largest value of 16 bits of mm that is not a mark
_MAX_SIGMA_M: Final = 655.0  # m: below the largest value of 16 bits of cm
_MAX_DEPTH_M: Final = 12_000.0  # m: deeper than any sea
_MAX_VIEWS: Final = 255  # of 8 bits
_VERTICAL_STEP_M: Final = 1e-3  # m, of depths and altitudes on the bus
_SPEED_STEP_MPS: Final = 0.01  # m/s, of speeds on the bus


def command_message(
    command: Command, valid_s: float, command_number: int, request_number: int
) -> GoToMessage | SteerMessage:
    """Translate a command. Depths and altitudes are rounded up in the water, speeds down, so that bounds stay kept."""
    vertical_m = shallower(command.vertical, _VERTICAL_STEP_M).value_m
    speed_mps = slower(command.speed_mps, _SPEED_STEP_MPS)
    reference = REFERENCES.index(command.vertical.reference)
    if isinstance(command, GoTo):
        return GoToMessage(
            latitude_deg=command.latitude_deg,
            speed_mps=speed_mps,
            longitude_deg=command.longitude_deg,
            radius_m=command.radius_m,
            vertical_m=vertical_m,
            vertical_reference=reference,
            valid_s=valid_s,
            command_number=command_number,
            request_number=request_number,
        )
    return SteerMessage(
        vertical_m=vertical_m,
        vertical_reference=reference,
        valid_s=valid_s,
        heading_rad=command.heading_rad % _TURN,
        speed_mps=speed_mps,
        command_number=command_number,
        request_number=request_number,
    )


def command_of(message: GoToMessage | SteerMessage) -> Command:
    """Translate a received command. Raises ValueError if a field is not available."""
    if any(math.isnan(value) for value in message):
        raise ValueError("a command must have all fields")
    vertical = Vertical(REFERENCES[message.vertical_reference], message.vertical_m)
    if isinstance(message, GoToMessage):
        return GoTo(message.latitude_deg, message.longitude_deg, vertical, message.speed_mps, message.radius_m)
    return Steer(message.heading_rad % _TURN, vertical, message.speed_mps)


def report_message(report: ContactReport, ticket: int) -> ReportMessage:
    """Translate a report.

    The session keeps its lower 32 bits; sizes, errors and depths too large become the largest value.
    """
    return ReportMessage(
        ticket=ticket,
        number=report.number,
        session=report.session & (1 << _SESSION_BITS) - 1,
        revision=report.revision,
        time_s=report.time_s,
        latitude_deg=report.latitude_deg,
        sigma_m=_within(report.sigma_m, _MAX_SIGMA_M),
        longitude_deg=report.longitude_deg,
        p_mine=report.p_mine,
        depth_m=_within(report.depth_m, _MAX_DEPTH_M),
        classification=CLASSES.index(report.classification),
        n_views=min(report.n_views, _MAX_VIEWS),
        length_m=_within(report.length_m, _MAX_SIZE_M),
        width_m=_within(report.width_m, _MAX_SIZE_M),
        height_m=_within(report.height_m, _MAX_SIZE_M),
        length_sigma_m=_within(report.length_sigma_m, _MAX_SIZE_M),
        width_sigma_m=_within(report.width_sigma_m, _MAX_SIZE_M),
        height_sigma_m=_within(report.height_sigma_m, _MAX_SIZE_M),
        **{f"belief_{name}": report.belief.get(name, math.nan) for name in CLASSES},
    )


def report_from_can(message: ReportMessage) -> ContactReport:
    """Turn a message into a contact's report."""
    shares = {name: float(getattr(message, f"belief_{name}")) for name in CLASSES}
    return ContactReport(
        session=message.session,
        number=message.number,
        revision=message.revision,
        time_s=message.time_s,
        latitude_deg=message.latitude_deg,
        longitude_deg=message.longitude_deg,
        sigma_m=message.sigma_m,
        p_mine=message.p_mine,
        classification=CLASSES[message.classification],
        belief={name: share for name, share in shares.items() if not math.isnan(share)},
        n_views=message.n_views,
        depth_m=message.depth_m,
        length_m=message.length_m,
        width_m=message.width_m,
        height_m=message.height_m,
        length_sigma_m=message.length_sigma_m,
        width_sigma_m=message.width_sigma_m,
        height_sigma_m=message.height_sigma_m,
    )


def text_message(text: str) -> HealthText:
    """Return the first 44 bytes of a text, no character cut in two."""
    whole = text.encode("utf-8", "replace")[:TEXT_BYTES].decode("utf-8", "ignore")
    data = whole.encode("utf-8").ljust(TEXT_BYTES, b"\0")
    parts, at = [], 0
    for n_bytes in _TEXT_PART_BYTES:
        parts.append(int.from_bytes(data[at : at + n_bytes], "little"))
        at += n_bytes
    return HealthText(*parts)


def text_of(message: HealthText) -> str:
    """Read the text of a message."""
    data = b"".join(part.to_bytes(n_bytes, "little") for part, n_bytes in zip(message, _TEXT_PART_BYTES, strict=True))
    return data.rstrip(b"\0").decode("utf-8", "replace")


def _within(value: float, largest: float) -> float:
    return value if math.isnan(value) else min(max(value, 0.0), largest)
