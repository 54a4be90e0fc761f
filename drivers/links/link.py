"""Open links, listen, report their state, and open them again for ever."""

from __future__ import annotations

import asyncio
import logging
import os
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any, Final, Generic, Literal, Protocol, TypeAlias, TypeVar

from auv_mcm.clock import Clock, Stamp
from auv_mcm.errors import HardwareError

log = logging.getLogger(__name__)

LinkState: TypeAlias = Literal["up", "silent", "down"]
OnState: TypeAlias = Callable[[LinkState, str], None]
T = TypeVar("T")

FIRST_RETRY_S: Final = 0.1  # s from a failure to the first attempt to open again, doubled from then on
LONGEST_RETRY_S: Final = 2.0  # s between attempts, maximum: so late a returned device is noticed
_POLL_S: Final = 0.005  # ports that nothing can wait for
_RETURN_POLL_S: Final = 0.02  # checking whether a path exists costs microseconds
_CHECKS_PER_SILENCE: Final = 4  # of the time after which a link is silent: so exactly silence is noticed


class Wire(Protocol[T]):
    """Carry T, bytes or CAN frames, on an open wire.

    Nothing here blocks; failures raise HardwareError and nothing else.

    note: what a person should know of how it opened, "" for nothing. pause_s: after a read that brought something, how
    long to let more come before the next one; 0: not at all.
    """

    @property
    def note(self) -> str:
        """Return what a person should know of how the wire opened, "" for nothing."""

    @property
    def pause_s(self) -> float:
        """Return how long to let more come before the next read, s."""

    @property
    def has_unsent(self) -> bool:
        """Return whether something waits until `fileno` can be written to."""
        ...

    def fileno(self) -> int:
        """Return the descriptor to wait for, -1 if there is none."""
        ...

    def read(self) -> list[T]:
        """Return what has arrived; empty if nothing has."""
        ...

    def write(self, item: T) -> bool:
        """Take the whole item, or return False."""
        ...

    def flush(self) -> None:
        """Send as much of the waiting data as the wire takes."""
        ...

    def on_silence(self) -> str:
        """React to silence: do what helps, and return advice on what to check."""
        ...

    def close(self) -> None: ...


class Link(Generic[T]):
    """Serve one wire, and report its data and its state from the event loop. Only cancelling ends `run`.

    on_data(item, stamp): each item received, stamped with when it was read. on_state(state, reason): "up" (open),
    "silent" (open, yet nothing for silent_after_s, as when a cable without hang-up is pulled) or "down"; reason says
    what, where and what to do. A link that is down is reported once, and once more only where its device is there and
    cannot be opened: then something else is wrong. Neither stops the link by raising: that is logged once and counted.
    counters: link.opened, .open_failed, .lost, .silences, .reads, .writes_refused, .callback_failed, and those of the
    kind of port.

    open_port: opens the wire, raises HardwareError. place: what the wire is called in messages. device: the path of a
    device that may be plugged out and in; as soon as it is back it is opened again.
    """

    def __init__(
        self,
        place: str,
        open_port: Callable[[Counter[str]], Awaitable[Wire[T]]],
        on_data: Callable[[T, Stamp], None],
        on_state: OnState,
        clock: Clock,
        silent_after_s: float,
        device: str | None = None,
    ) -> None:
        self.place = place
        self._device = device
        self.counters: Counter[str] = Counter()
        self._open_port = open_port
        self._on_data = on_data
        self._on_state = on_state
        self._clock = clock
        self._silent_after_s = silent_after_s
        self._reported: tuple[LinkState, str] = ("down", "")
        self._port: Wire[T] | None = None
        self._gone = asyncio.Event()
        self._writer_waits = False
        self._next_read: asyncio.TimerHandle | None = None  # while bytes gather, else the port is listened to
        self._silent_due_s = 0.0
        self._heard = False

    @property
    def state(self) -> LinkState:
        return self._reported[0]

    async def run(self) -> None:
        """Serve the wire until cancelled."""
        retry_s = FIRST_RETRY_S
        try:
            while True:
                self._heard = False
                await self._serve_once()
                if self._heard:
                    retry_s = FIRST_RETRY_S
                await self._pause(retry_s)
                retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)
        finally:
            self._report("down", f"{self.place} was closed")

    async def _pause(self, retry_s: float) -> None:
        """Wait before the next try; where the device is gone, for its return and no longer."""
        if self._device is None or os.path.exists(self._device):
            await asyncio.sleep(retry_s)
            return
        while not os.path.exists(self._device):
            await asyncio.sleep(_RETURN_POLL_S)

    def write(self, item: T) -> bool:
        """Send at once or as soon as the wire takes it.

        False: refused, because the wire is down or its bounded queue is full.
        """
        taken = False
        port = self._port
        if port is not None:
            try:
                taken = port.write(item)
                self._follow_writer(port)
            except HardwareError as error:
                self._lose(str(error))
        if not taken:
            self.counters["link.writes_refused"] += 1
        return taken

    async def _serve_once(self) -> None:
        try:
            port = await self._open_port(self.counters)
        except HardwareError as error:
            self.counters["link.open_failed"] += 1
            self._report_not_opened(str(error))
            return
        self.counters["link.opened"] += 1
        self._port = port
        self._gone.clear()
        try:
            if port.fileno() >= 0:
                asyncio.get_running_loop().add_reader(port.fileno(), self._readable)
            self._silent_due_s = self._clock.monotonic_s() + self._silent_after_s
            self._report("up", port.note or f"{self.place} is open")
            await self._watch(port)
        finally:
            self._detach()
            port.close()

    async def _watch(self, port: Wire[T]) -> None:
        polled = port.fileno() < 0
        pause_s = _POLL_S if polled else self._silent_after_s / _CHECKS_PER_SILENCE
        gone = asyncio.ensure_future(self._gone.wait())
        try:
            while not self._gone.is_set():
                await asyncio.wait([gone], timeout=pause_s)
                if polled and self._port is not None:
                    self._read(self._port)
                self._check_for_silence()
        finally:
            gone.cancel()

    def _check_for_silence(self) -> None:
        now_s = self._clock.monotonic_s()
        if self._port is None or now_s < self._silent_due_s:
            return
        self._silent_due_s = now_s + self._silent_after_s
        self.counters["link.silences"] += 1
        try:
            advice = self._port.on_silence()
            self._follow_writer(self._port)
        except HardwareError as error:
            self._lose(str(error))
        else:
            self._report("silent", f"{self.place}: nothing received for {self._silent_after_s:g} s. {advice}")

    def _readable(self) -> None:
        """Read, then by the clock as long as data arrives; listen again after none, or a full read."""
        port = self._port
        if port is None:
            return
        came = self._read(port)
        if port is not self._port:
            return
        pause_s = port.pause_s if came else 0.0
        if pause_s > 0.0:
            loop = asyncio.get_running_loop()
            if self._next_read is None:
                loop.remove_reader(port.fileno())
            self._next_read = loop.call_later(pause_s, self._readable)
        elif self._next_read is not None:
            self._next_read = None
            asyncio.get_running_loop().add_reader(port.fileno(), self._readable)

    def _read(self, port: Wire[T]) -> bool:
        """Hand on what has arrived; return whether anything has."""
        self.counters["link.reads"] += 1
        try:
            items = port.read()
        except HardwareError as error:
            self._lose(str(error))
            return False
        if not items:
            return False
        now_s = self._clock.monotonic_s()
        stamp = Stamp(mono_ns=round(now_s * 1e9), utc_ns=round(self._clock.utc_s() * 1e9))
        self._silent_due_s = now_s + self._silent_after_s
        self._heard = True
        if self.state == "silent":
            self._report("up", f"{self.place} sends data again")
        for item in items:
            self._call(self._on_data, item, stamp)
        return True

    def _writable(self) -> None:
        port = self._port
        if port is None:
            return
        try:
            port.flush()
            self._follow_writer(port)
        except HardwareError as error:
            self._lose(str(error))

    def _follow_writer(self, port: Wire[T]) -> None:
        """Wait for the wire to take more exactly while something waits."""
        if port is not self._port or port.has_unsent == self._writer_waits:
            return
        self._writer_waits = port.has_unsent
        loop = asyncio.get_running_loop()
        if self._writer_waits:
            loop.add_writer(port.fileno(), self._writable)
        else:
            loop.remove_writer(port.fileno())

    def _lose(self, reason: str) -> None:
        self._detach()
        self._gone.set()
        self.counters["link.lost"] += 1
        self._report("down", reason)

    def _detach(self) -> None:
        """Stop listening at once: a wire that hung up is readable for ever."""
        port, self._port, self._writer_waits = self._port, None, False
        if self._next_read is not None:
            self._next_read.cancel()
            self._next_read = None
        if port is not None and port.fileno() >= 0:
            loop = asyncio.get_running_loop()
            loop.remove_reader(port.fileno())
            loop.remove_writer(port.fileno())

    def _report_not_opened(self, reason: str) -> None:
        """Report a failed attempt to open, but only the first, or where the device is back and still cannot be
        opened."""
        is_news = self._reported[1] == "" or (self._device is not None and os.path.exists(self._device))
        if is_news:
            self._report("down", reason)
        elif (self.state, reason) != self._reported:
            self._reported = "down", reason
            log.info("%s", reason)

    def _report(self, state: LinkState, reason: str) -> None:
        if (state, reason) != self._reported:
            self._reported = state, reason
            self._call(self._on_state, state, reason)

    def _call(self, callback: Callable[..., None], *arguments: Any) -> None:
        try:
            callback(*arguments)
        except Exception:
            self.counters["link.callback_failed"] += 1
            if self.counters["link.callback_failed"] == 1:
                log.exception(
                    "%s: a receiver failed; the link goes on. This is a defect: report it with the log.", self.place
                )
