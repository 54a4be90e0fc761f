"""The auv-mcm command. Everything heavy is imported by the subcommand that needs it."""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
from collections.abc import Callable, Sequence

from auv_mcm import __version__
from auv_mcm.commands import EXIT_CODES
from auv_mcm.errors import AuvMcmError, HardwareError, UsageError
from auv_mcm.shell.registry import COMMANDS, load

_INTERRUPTED = 130  # what shells report for a program ended by Ctrl-C
_BENCH_EXTRA = {"pyxtf", "rich", "matplotlib", "jinja2", "dask", "distributed"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    arguments = _parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        code = command(arguments)
        sys.stdout.flush()
        return code
    except AuvMcmError as error:
        return _fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _fail("interrupted", _INTERRUPTED)
    except ModuleNotFoundError as error:
        if error.name not in _BENCH_EXTRA:
            raise
        return _fail(f"this command needs the package {error.name}: python -m pip install 'auv-mcm[bench]'", UsageError.exit_code)
    except BrokenPipeError:
        # Whoever read our output, such as head, has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _fail(f"{error.filename or 'input or output'}: {error.strerror or error}", HardwareError.exit_code)


def _fail(text: str, code: int) -> int:
    print(f"auv-mcm: {text}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="auv-mcm",
        description="Payload service of a mine-hunting AUV: side-scan pings and navigation in, contacts, coverage and way-points out.",
        epilog=f"'auv-mcm COMMAND --help' explains a command. {EXIT_CODES}.",
    )
    parser.add_argument("--version", action="version", version=f"auv-mcm {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    has_bench = importlib.util.find_spec("sim_replay") is not None
    for name in COMMANDS.values():
        if has_bench or not name.startswith("sim_replay."):
            load(name)(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
