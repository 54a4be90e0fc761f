"""The self-check."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from auv_mcm.commands import Commands, add_config_option, command, read_config
from auv_mcm.errors import AuvMcmError

if TYPE_CHECKING:
    from auv_mcm.settings.config import Config
    from auv_mcm.shell.check.finding import Finding


def add(commands: Commands) -> None:
    """Add `auv-mcm check` to the command line."""
    parser = command(
        commands,
        "check",
        "check that this installation does what it should",
        "Looks at Python, packages and their versions, the C kernels against numpy, the models, the plug-ins "
        "(drivers,\n"
        "vehicle dialects and log readers of other packages), the clock, the output directory and its room, the\n"
        "perception process, the configuration, and whether logs can be replayed: those named, and the one that\n"
        "service.source plays. With a configuration, opens each of its ports and listens for 4 s: does the\n"
        "device that the configuration names speak there? Sends nothing, changes nothing, and leaves ports alone that\n"
        "another program uses. Each line says what, where and what to do. Exit code 5 if something failed; a warning "
        "is\n"
        "no failure.",
        ["auv-mcm check", "auv-mcm check --config vehicle.yaml", "auv-mcm check survey.jsf"],
    )
    parser.add_argument(
        "logs",
        metavar="LOG",
        nargs="*",
        type=Path,
        help="log to look into: XTF, JSF, svlog, SDF, SL2, SL3, SON, image or a recorded session",
    )
    add_config_option(parser)
    parser.add_argument("--json", action="store_true", help="print findings as JSON, one a line, for scripts")
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from auv_mcm.shell.check import run_checks

    return run_checks(
        lambda: read_config(arguments.config),
        print,
        lambda config: _check_logs(arguments.logs, config),
        as_json=arguments.json,
    )


def _check_logs(paths: Sequence[Path], config: Config) -> Iterator[Finding]:
    """Check that each log, and the one that the configured source plays, holds pings that can be replayed."""
    for path in [*paths, *_source_log(config)]:
        yield _check_log(path, config)


def _check_log(path: Path, config: Config) -> Finding:
    from auv_mcm.shell.check.finding import Finding
    from auv_mcm.shell.registry import DESCRIBE_LOG, LOG_DOUBT, load

    name = f"log {path.name}"
    try:
        described: str = load(DESCRIBE_LOG)(path, config)
        doubt: str = load(LOG_DOUBT)(path, config)
        return Finding(name, "warning", f"{described}; {doubt}") if doubt else Finding(name, "ok", described)
    except AuvMcmError as error:
        return Finding(name, "FAILED", str(error))
    except ImportError as error:
        return Finding(name, "FAILED", f"{error}: python -m pip install 'auv-mcm[bench]'")


def _source_log(config: Config) -> list[Path]:
    from auv_mcm.shell.sources import parse_source_uri

    if not config.service.source:
        return []
    try:
        source = parse_source_uri(config.service.source)
    except AuvMcmError:
        return []  # a finding about the configuration
    return [Path(source.path)] if source.scheme == "replay" and source.path else []
