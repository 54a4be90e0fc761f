"""Check an installation: one line per part.

Only the standard library is imported before the packages have been checked, so that a missing one is a finding.
"""

from __future__ import annotations

import json
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from auv_mcm import __version__
from auv_mcm.clean_text import clean_json, clean_lines, tinted
from auv_mcm.errors import AuvMcmError, SelfCheckError
from auv_mcm.shell.check.finding import Finding
from auv_mcm.shell.check.host import clock_discipline, clock_finding, output_finding, reach_findings, user_findings
from auv_mcm.shell.check.packages import has_extra, package_findings
from auv_mcm.shell.registry import BENCH_CHECK, PORT_CHECK, load

if TYPE_CHECKING:
    from auv_mcm.settings.config import Config

_COLOURS: Final = {"ok": "green", "warning": "yellow", "FAILED": "red"}


def run_checks(
    read_config: Callable[[], Config],
    write: Callable[[str], None],
    check_logs: Callable[[Config], Iterable[Finding]] = lambda config: (),
    *,
    as_json: bool = False,
) -> int:
    """Check everything, write a table line by line, and return the exit code.

    The code is 0, or SelfCheckError's if any check failed.

    A configuration that cannot be read is one of the findings.

    Parameters
    ----------
    read_config
        Reads the configuration to check.
    write
        Takes each line.
    check_logs
        Gives the findings about recorded logs.
    as_json
        Write each finding as an object of JSON, and no sum of them.
    """
    verdicts = []
    for finding in _findings(read_config, check_logs):
        if as_json:
            write(clean_json(json.dumps(finding._asdict(), ensure_ascii=False)))
        else:
            verdict = tinted(f"{finding.verdict:8}", _COLOURS[finding.verdict])
            write(verdict + clean_lines(f"{finding.name:32}{finding.detail}"))
        verdicts.append(finding.verdict)
    if as_json:
        return SelfCheckError.exit_code if "FAILED" in verdicts else 0
    n_failed, n_warnings = verdicts.count("FAILED"), verdicts.count("warning")
    counted = f"{n_failed} failed" if n_failed else "nothing failed"
    write(
        f"{counted}, {n_warnings} warning{'s' * (n_warnings > 1)}"
        if n_warnings
        else counted
        if n_failed
        else "all good"
    )
    return SelfCheckError.exit_code if n_failed else 0


def _findings(
    read_config: Callable[[], Config], check_logs: Callable[[Config], Iterable[Finding]]
) -> Iterator[Finding]:
    yield Finding("auv-mcm", "ok", f"{__version__} in {Path(__file__).parents[2]}")
    yield Finding(
        "python",
        "ok" if sys.version_info >= (3, 11) else "FAILED",
        f"{platform.python_version()} on {platform.machine()}",
    )
    yield from user_findings(os.geteuid())
    yield from reach_findings(os.geteuid(), [Path(sys.executable).resolve(), Path(__file__).resolve()])
    yield from package_findings()
    yield from _looked_at("C kernels", _kernels)
    if has_extra("bench"):
        yield from _looked_at("bench", lambda: load(BENCH_CHECK)())
    yield from _looked_at("odds of confirmation", _odds)
    yield from _looked_at("plug-ins", _plugins)
    config: Config | None = None
    try:
        config = read_config()
        yield from _looked_at("configuration", partial(_configuration, config))
    except (AuvMcmError, ImportError) as error:
        yield Finding("configuration", "FAILED", str(error))
    yield from _looked_at("service", partial(_as_configured, config))
    yield from _looked_at("logs", lambda: check_logs(config or _default_config()))


def _default_config() -> Config:
    from auv_mcm.settings.config import Config

    return Config()


def _as_configured(config: Config | None) -> Iterator[Finding]:
    """Check what depends on the configuration, on the default one if there is none that can be read."""
    config = config or _default_config()
    yield from _looked_at("detector", partial(_detector, config))
    yield from _models(config)
    gives_utc = any(port.navigation is not None and port.navigation.gives_utc for port in config.ports)
    yield clock_finding(time.time(), clock_discipline(), Path(__file__).parents[2], gives_utc)
    yield output_finding(Path(config.service.output_directory))
    if config.ports and config.service.source in ("", "ports"):
        yield from _looked_at("ports", lambda: load(PORT_CHECK)(config))
    elif config.ports:
        yield Finding("ports", "ok", f"not checked, because service.source is {config.service.source}")
    yield from _looked_at("perception process", partial(_perception, config))


def _looked_at(name: str, look: Callable[[], Iterable[Finding]]) -> Iterator[Finding]:
    """Give the findings of one check, or report that it could not be made."""
    try:
        yield from look()
    except (AuvMcmError, OSError, ImportError) as error:
        yield Finding(name, "FAILED", str(error))


def _configuration(config: Config) -> Iterator[Finding]:
    from auv_mcm.shell.sources import parse_source_uri

    if config.service.source:
        uri = parse_source_uri(config.service.source)
        if uri.scheme == "ports" and not config.ports:
            text = (
                "service.source is 'ports', but no port is configured: add a section 'ports'; 'auv-mcm run --example' "
                "prints one"
            )
            yield Finding("configuration", "FAILED", text)
            return
        if uri.scheme == "replay" and not Path(uri.path).exists():
            text = (
                f"service.source {config.service.source}: {uri.path} does not exist. Name a log, or the folder of a "
                "recorded session"
            )
            yield Finding("configuration", "FAILED", text)
            return
    yield Finding("configuration", "ok", "valid")


def _detector(config: Config) -> Iterator[Finding]:
    from auv_mcm.detect.cascade.choose import configured_model, fitting

    _, notice = fitting(configured_model(config), config)
    yield Finding("detector", "ok" if notice.for_the_record else "warning", notice.text)


def _models(config: Config) -> Iterator[Finding]:
    """Check each model file on its own, so that a broken one hides no other."""
    from auv_mcm.clearance.detection_performance import configured_performance
    from auv_mcm.model_file import SHIPPED
    from auv_mcm.seabed.seabed_model import configured_seabed_model

    fitted_together = (config.confirm.odds, config.detect.gate, config.contacts.background)
    if any(name != SHIPPED for name in fitted_together):
        yield from _looked_at("odds configured", partial(_configured_odds, config))
    if config.confirm.targets != SHIPPED:
        yield from _looked_at(
            "mines expected", lambda: [expected_mines(config.confirm.targets, config.contacts.min_p_mine)]
        )
    yield from _looked_at(
        "seabed model", lambda: [Finding("seabed model", "ok", configured_seabed_model(config).fitted_on)]
    )
    yield from _looked_at(
        "performance tables", lambda: [Finding("performance tables", "ok", configured_performance(config).fitted_on)]
    )


def _configured_odds(config: Config) -> Iterator[Finding]:
    from auv_mcm.classify.odds import configured_odds
    from auv_mcm.contacts.background import configured_background
    from auv_mcm.detect.cascade.choose import configured_model, fitting
    from auv_mcm.detect.gate import configured_gate
    from auv_mcm.records import Detector

    detector: Detector = "contrast" if fitting(configured_model(config), config)[0] is None else "cascade"
    odds, gate = configured_odds(config, detector), configured_gate(config.detect.gate)
    configured_background(config.contacts.background, detector)
    yield Finding("odds configured", "ok", f"{odds.fitted_on}; gate: {'none' if gate is None else gate.fitted_on}")


def expected_mines(name: str, min_p_mine: float) -> Finding:
    """Say which mines a list expects, and what is at risk where it is incomplete.

    min_p_mine: the lowest that is reported.
    """
    from auv_mcm.classify.size_evidence import is_usual
    from auv_mcm.classify.targets import configured_targets, mine_words
    from auv_mcm.detect.belief import odds_of, probability

    library = configured_targets(name)
    lost_nats = -math.log(library.not_listed)
    left = ", ".join(f"{p:g} to {probability(odds_of(p) - lost_nats):.2f}" for p in (0.9, 0.5))
    unreported = ""
    if min_p_mine > 0.0:
        lowest = probability(odds_of(min_p_mine) + lost_nats)
        unreported = f", and below {lowest:.2f} to less than contacts.min_p_mine, which is not reported"
    words = (
        f"{'; '.join(map(mine_words, library.mines))}. A mine on no line of the list may lose {lost_nats:.1f} nats in "
        f"one view, by not_listed {library.not_listed:g}: p_mine {left}{unreported}. List every type that may lie there"
    )
    unusual = [mine_words(mine) for mine in library.mines if not is_usual(mine)]
    if unusual:
        words += (
            f". Beyond the sizes that the odds of a mine were fitted on, so that none of this was measured: "
            f"{'; '.join(unusual)}"
        )
    return Finding("mines expected", "warning" if unusual else "ok", words)


def _kernels() -> Iterator[Finding]:
    import numpy as np

    from auv_mcm import kernels
    from auv_mcm.kernels.viterbi import viterbi_forward, viterbi_forward_numpy

    if kernels.backend() == "numpy":
        text = (
            "NUMPY DOES THEIR WORK, which takes some twelve times the processor time: a vehicle may lose pings. "
            f"{kernels.loaded().reason}"
        )
        yield Finding("C kernels", "warning", text)
        return
    random = np.random.default_rng(0)
    score = random.normal(size=(64, 257))
    score[random.random(score.shape) < 0.2] = -np.inf
    (cost, back), (cost_numpy, back_numpy) = (
        viterbi_forward(score[0], score, 5, 0.3),
        viterbi_forward_numpy(score[0], score, 5, 0.3),
    )
    same = np.array_equal(cost, cost_numpy) and np.array_equal(back, back_numpy)
    yield Finding(
        "C kernels",
        "ok" if same else "FAILED",
        f"{kernels.loaded().reason}, {'equal to' if same else 'NOT EQUAL to'} numpy",
    )


def _odds() -> Iterator[Finding]:
    from typing import get_args

    from auv_mcm.classify.odds import shipped_odds
    from auv_mcm.classify.verifier import network_of
    from auv_mcm.records import Detector

    for detector in get_args(Detector):
        odds = shipped_odds(detector)
        words = f"{detector}: {odds.fitted_on}"
        if odds.verifier is not None:
            network_of(odds.verifier.digest, odds.verifier.file)
            words += f". {odds.made_by}. Verifier: {odds.verifier.trained_on}"
        yield Finding("odds of confirmation", "ok", words)


def _plugins() -> Iterator[Finding]:
    from auv_mcm.shell.check.plugins import plugin_findings

    yield from plugin_findings()


def _perception(config: Config) -> Iterator[Finding]:
    import asyncio

    from auv_mcm.shell.perception import Perception
    from auv_mcm.shell.perception_messages import Finished

    async def start_and_finish() -> None:
        perception = Perception(config)
        try:
            await perception.start()
            await perception.finish()
            while not isinstance(await perception.answer(), Finished):
                pass
        finally:
            perception.close()

    asyncio.run(start_and_finish())
    yield Finding("perception process", "ok", "starts, answers and ends")
