"""Give every wire format as it is framed: messages of its devices to draw, and what reads them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm.settings.vehicle_settings import BluefinSettings, IverSettings, ReconSettings
from drivers.framing import Framer, Grammar
from drivers.links.can_frame import CanFrame
from drivers.links.slcan import SlcanParser
from drivers.links.slcan import encode as slcan_encode
from drivers.navigation import dvl_pd6, dvl_water_linked, n2k_messages, sentences
from drivers.navigation.n2k_fast_packet import MAX_MESSAGE_BYTES, FastPackets, frames_of
from drivers.navigation.n2k_messages import FAST_PACKET_GROUPS, GLOBAL, Identifier, can_id_of, identifier_of
from drivers.navigation.nmea0183 import NmeaGrammar, sentence
from drivers.sonar import imagenex, jsf_messages, ping_messages
from drivers.sonar.imagenex import IgxGrammar, IgxReturn
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.jsf_messages import JsfMessage, SideScanData, SideScanHeader
from drivers.sonar.ping_messages import AsciiText, OsMonoProfile
from drivers.sonar.ping_protocol import PingGrammar
from drivers.vehicle import bluefin_sentences, can_messages, imc_codec, imc_messages, iver_sentences, recon_sentences
from drivers.vehicle.bluefin_sentences import BluefinGrammar
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.imc_wire import ImcGrammar, ImcPacket, to_wire
from drivers.vehicle.iver_sentences import IverGrammar
from drivers.vehicle.recon_sentences import ReconGrammar

Read = Callable[[bytes], Iterable[Hashable]]
_VEHICLE_CAN_ADDRESS: Final = 96  # on the bus


class FramedWire(NamedTuple):
    """Describe one wire format.

    messages: n intact messages as bytes, no two alike. reader: makes anew what takes its bytes, and at the end none,
    and gives an equal item for equal messages.
    """

    name: str
    messages: Callable[[np.random.Generator, int], list[bytes]]
    reader: Callable[[], Read]

    def read(self, chunks: Iterable[bytes]) -> list[Hashable]:
        """Read all messages of a stream, to its end."""
        reader = self.reader()
        return [item for chunk in (*chunks, b"") for item in reader(chunk)]


def _by(grammar: Callable[[], Grammar[Any]], key: Callable[[Any], Hashable]) -> Callable[[], Read]:
    """Make the reader of a grammar of drivers.framing. key: of a message, equal for equal messages."""

    def reader() -> Read:
        framer = Framer(grammar())
        return lambda data: [key(framed.message) for framed in (framer.feed(data) if data else framer.finish())]

    return reader


def ping_stream_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Draw n messages of Ping Protocol: profiles, and texts between them."""
    wired = []
    for number in range(n):
        if random.random() < 0.2:
            wired.append(ping_messages.encode(AsciiText(f"message {number} " + "BR" * int(random.integers(20)))))
        else:
            wired.append(ping_messages.encode(_profile(number, int(random.integers(20, 200)), random)))
    return wired


def _jsf_messages(random: np.random.Generator, n: int) -> list[bytes]:
    wired = []
    for number in range(n):
        if random.random() < 0.2:
            body = number.to_bytes(4, "little") + random.bytes(int(random.integers(80)))
            wired.append(jsf_messages.to_wire(JsfMessage(2002, body, session=number & 0xFF)))
        else:
            wired.append(jsf_messages.encode_data(_side(number, int(random.integers(20, 200)), random), 21, number & 1))
    return wired


def _igx_messages(random: np.random.Generator, n: int) -> list[bytes]:
    return [imagenex.encode_return(IgxReturn(30, 3, random.integers(0, 128, 400).astype(np.uint8))) for _ in range(n)]


def _nmea_messages(random: np.random.Generator, n: int) -> list[bytes]:
    records: list[sentences.Record] = []
    for number in range(n):
        time_of_day_s = 0.1 * number
        latitude_deg, longitude_deg = random.uniform(-80.0, 80.0), random.uniform(-179.0, 179.0)
        if number % 4 == 0:
            records.append(sentences.Gga(time_of_day_s, latitude_deg, longitude_deg, 1.0, 9.0, 1.1, 12.3, 40.1))
        elif number % 4 == 1:
            records.append(
                sentences.Rmc(
                    time_of_day_s, "A", latitude_deg, longitude_deg, 2.0, random.uniform(0.0, 6.0), 19_700.0, 0.02, "A"
                )
            )
        elif number % 4 == 2:
            records.append(sentences.Zda(time_of_day_s, 19_700.0))
        else:
            records.append(sentences.Pashr(time_of_day_s, random.uniform(0.0, 6.0), 0.01, -0.02))
    return [sentence(sentences.body_of(record)) for record in records]


def _pixse_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make bursts of a PHINS, each sentence a message."""
    bursts: list[sentences.Record] = []
    while len(bursts) < n:
        number = len(bursts)
        bursts += [
            sentences.Hdt(math.radians(0.1 * number)),
            sentences.PixseAttitude(math.radians(0.1 * number), random.normal(0.0, 0.05)),
            sentences.PixsePosition(43.0 + 1e-4 * number, random.uniform(5.0, 6.0), -random.uniform(1.0, 90.0)),
            sentences.PixseSpeed(0.01 * number, random.normal(0.0, 1.0), 0.0),
            sentences.PixseTime(0.1 * number),
        ]
    return [sentence(sentences.body_of(record)) for record in bursts[:n]]


def _water_linked_messages(random: np.random.Generator, n: int) -> list[bytes]:
    records: list[dvl_water_linked.Record] = []
    for number in range(n):
        if number % 2:
            x_m, y_m, z_m = random.uniform(-90.0, 90.0, 3).tolist()
            records.append(dvl_water_linked.WaterLinkedAttitude(0.1 * number, x_m, y_m, z_m, 0.4, 0.01, -0.02, 1.0, 0))
            continue
        covariance = tuple(random.uniform(0.0, 1e-6, 9))
        validity_us = 1_700_000_000_000_000 + 125_000 * number
        reported_us = validity_us + 80_000
        forward, starboard, down = random.normal(0.0, 1.0, 3).tolist()
        records.append(
            dvl_water_linked.Velocity(
                forward, starboard, down, True, 7.5, 0.002, covariance, validity_us, reported_us, 125.0, 0
            )
        )
    return [dvl_water_linked.message_of(record) for record in records]


def _pd6_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make groups of a DVL, each line a message."""
    lines: list[dvl_pd6.Line] = []
    while len(lines) < n:
        number = len(lines)
        lines += [
            dvl_pd6.Pd6Attitude(random.normal(0.0, 0.05), random.normal(0.0, 0.05), math.radians(0.1 * number)),
            dvl_pd6.Water(1_700_000_000.0 + 0.1 * number, 35.0, 12.0, random.uniform(1.0, 90.0), 1500.0),
            dvl_pd6.ShipVelocity(1e-3 * number, random.normal(1.5, 0.1), 0.0, True),
            dvl_pd6.Bottom(float(number), random.uniform(-900.0, 900.0), 0.0, random.uniform(2.0, 20.0), 0.0),
        ]
    return [dvl_pd6.line_of(line) for line in lines[:n]]


def _imc_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make packets of a vehicle in either byte order, some of kinds that the reader does not know."""
    wired = []
    for number in range(n):
        order: imc_codec.Order = ">" if random.random() < 0.2 else "<"
        message: imc_messages.ImcMessage
        if number % 4 == 0:
            message = imc_messages.EstimatedState(*random.uniform(-1.5, 1.5, 2), *random.normal(0.0, 10.0, 18))
        elif number % 4 == 1:
            message = imc_messages.PlanControlState(3, f"survey {number}", man_id="T" * int(random.integers(20)))
        elif number % 4 == 2:
            reference = imc_messages.Reference(1, lat=random.uniform(-1.5, 1.5), lon=random.uniform(-3.0, 3.0))
            message = imc_messages.FollowRefState(0x6000, 255, reference, 2, 1)
        else:
            wired.append(
                to_wire(
                    ImcPacket(276, random.bytes(int(random.integers(200))), 0x1E, time_s=float(number), order=order)
                )
            )
            continue
        payload = imc_codec.encode(message, order)
        wired.append(
            to_wire(ImcPacket(imc_codec.number_of(type(message)), payload, 0x1E, time_s=float(number), order=order))
        )
    return wired


def _bluefin_messages(random: np.random.Generator, n: int) -> list[bytes]:
    table = bluefin_sentences.table_of(BluefinSettings())
    records: list[Any] = []
    for number in range(n):
        time_s, (angle_rad, speed_mps) = 0.1 * number, random.uniform(0.0, 1.5, 2).tolist()
        place = random.uniform(-80.0, 80.0), random.uniform(-179.0, 179.0)
        if number % 3 == 0:
            position = (*place, 1.0, 5.0, random.uniform(1.0, 90.0), 4.0 * angle_rad, 0.01, -0.02, time_s)
            records.append(bluefin_sentences.BluefinPosition(time_s, *position))
        elif number % 3 == 1:
            records.append(bluefin_sentences.BluefinVelocity(time_s, angle_rad, speed_mps, 0.0))
        else:
            records.append(bluefin_sentences.BluefinAnswer(time_s, "RMB", time_s, "2", "taken"))
    return [sentence(table.body_of(record)) for record in records]


def _iver_messages(random: np.random.Generator, n: int) -> list[bytes]:
    table = iver_sentences.table_of(IverSettings())
    records: list[Any] = []
    for number in range(n):
        angle_rad, place_deg = random.uniform(0.0, 1.5), random.uniform(-80.0, 80.0, 2).tolist()
        if number % 2:
            records.append(
                iver_sentences.IverCompass(0.004 * number, angle_rad, -angle_rad, 20.0, random.uniform(0.0, 90.0))
            )
        else:
            records.append(
                iver_sentences.IverState._make(["NAWM"[number % 4], *place_deg, 1.5, 5.0, 0.004 * number, 12.0])
            )
    return [iver_sentences.line_of(table, record) for record in records]


def _recon_messages(random: np.random.Generator, n: int) -> list[bytes]:
    table = recon_sentences.table_of(ReconSettings())
    records = []
    for number in range(n):
        place_deg = random.uniform(-80.0, 80.0, 2).tolist()
        attitude = random.uniform(-0.2, 0.2, 2).tolist()
        going = (1500.0, 1500.0, 1.5, 0.004 * number, 0.0, 0.0, 1 + 12 * (number % 2), str(number))
        records.append(recon_sentences.ReconState._make([0.5 * number, *place_deg, 12.0, 12.0, 5.0, *attitude, *going]))
    return [recon_sentences.frame(table.body_of(record)) for record in records]


def _slcan_messages(random: np.random.Generator, n: int) -> list[bytes]:
    wired = []
    for number in range(n):
        data = number.to_bytes(2, "little") + random.bytes(int(random.integers(7)))
        extended = bool(random.random() < 0.8)
        wired.append(slcan_encode(CanFrame(int(random.integers(1 << (29 if extended else 11))), data, extended)))
    return wired


def _fast_packet_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make messages of 43 bytes, as a GNSS position has, and more, of three units by way of an slcan adapter."""
    pgn = n2k_messages.encode(n2k_messages.GnssPosition(*[math.nan] * 14))[0]
    assert pgn in FAST_PACKET_GROUPS
    wired = []
    for number in range(n):
        data = number.to_bytes(2, "little") + random.bytes(int(random.integers(41, MAX_MESSAGE_BYTES - 1)))
        can_id = can_id_of(Identifier(3, pgn, GLOBAL, 12 + number % 3))
        wired.append(b"".join(slcan_encode(CanFrame(can_id, frame)) for frame in frames_of(data, number // 3)))
    return wired


def _vehicle_can_messages(random: np.random.Generator, n: int) -> list[bytes]:
    """Make reports, commands and statuses of a payload, of 11, 4 and 1 frames, by way of an slcan adapter."""
    wired = []
    for number in range(n):
        message: can_messages.Record
        if number % 3 == 0:
            place = random.uniform(-80.0, 80.0), 1.0, random.uniform(-179.0, 179.0)
            message = can_messages.ReportMessage(1, number, 7, 1, 1e9, *place, 0.5, 18.0, 0, 1, *random.random(12))
        elif number % 3 == 1:
            message = can_messages.GoToMessage(
                random.uniform(-80.0, 80.0), 1.5, random.uniform(-179.0, 179.0), 3.0, 5.0, 1, 3.0, number, 1
            )
        else:
            message = can_messages.PayloadStatus(1, 3, 1, 1, number)
        wired.append(b"".join(map(slcan_encode, can_messages.encode(message, _VEHICLE_CAN_ADDRESS, number))))
    return wired


def _profile(number: int, n_results: int, random: np.random.Generator) -> OsMonoProfile:
    """Make one side of a ping of an Omniscan 450, speckle on a scale of 80 dB; channels alternate."""
    power_db = -30.0 + 10.0 * np.log10(random.standard_exponential(n_results) + 1e-6)
    results = np.clip((power_db + 90.0) / 80.0 * 65535.0, 0.0, 65535.0).astype(np.uint16)
    return OsMonoProfile(
        ping_number=number // 2,
        start_mm=0,
        length_mm=50_000,
        timestamp_ms=number // 2 * 67,
        ping_hz=450_000,
        gain_index=3,
        sound_speed_dmps=15_000,
        channel_number=number & 1,
        pulse_duration_sec=1e-4,
        analog_gain=8.0,
        max_pwr_db=-10.0,
        min_pwr_db=-90.0,
        transducer_heading_deg=0.0,
        vehicle_heading_deg=0.0,
        pwr_results=results,
    )


def _side(number: int, n_samples: int, random: np.random.Generator) -> SideScanData:
    """Make one side of a ping of an EdgeTech sonar, speckle of amplitude; its two sides have consecutive numbers."""
    header = SideScanHeader(
        time_s=1_700_000_000 + number // 2 // 15,
        ping_number=number // 2,
        milliseconds_today=number // 2 * 67 % 1000,
        interval_ns=20_000,
        weighting=4,
        sound_speed_mps=1500.0,
        validity=jsf_messages.Validity.SOUND_SPEED,
    )
    return SideScanData(header, (3000.0 * np.sqrt(random.standard_exponential(n_samples))).astype(np.uint16))


def _slcan_reader() -> Read:
    parser = SlcanParser(Counter())
    return lambda data: list(parser.feed(data))


def _fast_packet_reader() -> Read:
    parser, packets = SlcanParser(Counter()), FastPackets()

    def read(data: bytes) -> list[Hashable]:
        found: list[Hashable] = []
        for frame in parser.feed(data):
            _, pgn, _, source = identifier_of(frame.can_id)
            whole = packets.add(pgn, source, frame.data) if frame.extended and pgn in FAST_PACKET_GROUPS else None
            if whole is not None:
                found.append((source, whole))
        return found

    return read


def _vehicle_can_reader() -> Read:
    parser, receiver = SlcanParser(Counter()), CanReceiver("vehicle_can", "payload", _VEHICLE_CAN_ADDRESS, Counter())

    def read(data: bytes) -> list[Hashable]:
        whole = (receiver.add(frame, 0.0) for frame in parser.feed(data))
        return [received.record for received in whole if received is not None]

    return read


WIRES: Final = (
    FramedWire("ping_protocol", ping_stream_messages, _by(PingGrammar, tuple)),
    FramedWire("jsf", _jsf_messages, _by(JsfGrammar, tuple)),
    FramedWire("sportscan", _igx_messages, _by(IgxGrammar, lambda ping: ping.echo.tobytes())),
    FramedWire("nmea0183", _nmea_messages, _by(NmeaGrammar, str)),
    FramedWire("pixse", _pixse_messages, _by(NmeaGrammar, str)),
    FramedWire("water_linked", _water_linked_messages, _by(dvl_water_linked.TextGrammar, str)),
    FramedWire("pd6", _pd6_messages, _by(dvl_pd6.LineGrammar, tuple)),
    FramedWire("imc", _imc_messages, _by(ImcGrammar, tuple)),
    FramedWire("bluefin", _bluefin_messages, _by(BluefinGrammar, str)),
    FramedWire("iver", _iver_messages, _by(IverGrammar, str)),
    FramedWire("recon", _recon_messages, _by(ReconGrammar, str)),
    FramedWire("slcan", _slcan_messages, _slcan_reader),
    FramedWire("fast_packet", _fast_packet_messages, _fast_packet_reader),
    FramedWire("vehicle_can", _vehicle_can_messages, _vehicle_can_reader),
)
