"""Run the service of this process until its source ends or a signal stops it."""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
from pathlib import Path
from typing import Final

from auv_mcm.clock import Clock, SystemClock
from auv_mcm.settings.config import Config
from auv_mcm.shell.journal_stream import is_journal, journal_console
from auv_mcm.shell.perception_chain import MakePipeline, standard_pipeline
from auv_mcm.shell.service import Service
from auv_mcm.shell.sources import open_source, parse_source_uri

log = logging.getLogger(__name__)

_SWITCH_S: Final = 5e-4
"""For which the thread that records may hold up the event loop; Python's own 5 ms are a ping's whole allowance."""


def serve(config: Config, *, clock: Clock | None = None, make_pipeline: MakePipeline = standard_pipeline) -> Path:
    """Run the service in this process until its source ends or a signal stops it; returns the folder with the results.

    clock: this computer's own if None.

    Raises AuvMcmError, or KeyboardInterrupt after a second signal.
    """
    sys.setswitchinterval(_SWITCH_S)
    clock = clock or SystemClock()
    source = open_source(parse_source_uri(config.service.source), config, clock)

    async def main() -> Path:
        console = journal_console(print) if is_journal(sys.stdout) else print
        service = Service(config, source, clock=clock, console=console, make_pipeline=make_pipeline)
        loop = asyncio.get_running_loop()
        serving = asyncio.ensure_future(service.run())
        signals = 0

        def on_signal(number: signal.Signals) -> None:
            nonlocal signals
            signals += 1
            if signals == 1:
                log.info("%s: finishing; once more to end at once", number.name)
                service.stop()
            else:
                log.warning("%s again: ending at once", number.name)
                serving.cancel()

        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # SIGHUP: the terminal is gone
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # by nohup it may go
                loop.add_signal_handler(number, on_signal, number)
        try:
            return await serving
        except asyncio.CancelledError:
            raise KeyboardInterrupt from None

    return asyncio.run(main())
