"""Define the auv-mcm command. Everything heavy is imported by the subcommand that needs it."""

from __future__ import annotations

import argparse
import errno
import importlib.util
import io
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from auv_mcm import __version__
from auv_mcm.clean_text import clean_lines
from auv_mcm.commands import EXIT_CODES, Parser
from auv_mcm.errors import AuvMcmError, HardwareError, UsageError, first_of
from auv_mcm.shell.registry import COMMAND_GROUPS, COMMANDS, COMPLETION, load

_INTERRUPTED = 130  # what shells report for a program ended by Ctrl-C
_EXTRAS = {
    "bench": {
        *("scipy", "pyxtf", "rich", "jinja2", "tifffile", "h5py", "mpmath", "mcap_protobuf", "pyproj", "fpdf"),
        *("shtab", "markupsafe", "google", "foxglove_schemas_protobuf"),
    },
    "bench,cluster": {"dask", "distributed"},
    "bench,view": {"aiohttp"},
    "bench,verifier": {"torch", "onnx"},
    "bench,dev": {"matplotlib", "PIL"},
}
"""Packages that commands need, by what to install for them."""
_REMEDIES = {
    errno.EACCES: "Check the permissions of it and of the folders above it",
    errno.EROFS: "Its disk can only be read: name another folder",
    errno.ENOSPC: "Make room on its disk",
    errno.EDQUOT: "Make room, or ask for a larger quota",
    errno.EIO: "Its disk may be failing: copy what it holds",
}
"""What to do about errors of the system that no command expects."""
_LARGE_PRODUCTS = (["train"], ["calibrate"])  # commands that multiply large matrices


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    _fill_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # what the terminal's encoding lacks is no reason to fail
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] not in _LARGE_PRODUCTS:
        # Read when numpy is loaded. Its threads begin by waiting busily, 25 ms of a core each, for products of matrices
        # that are too small to be shared.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if words[:2] == ["train", "--"]:
        del words[1]  # scripts of earlier versions need it, where options of the training come first
    try:
        arguments = _parser().parse_args(words)
        command: Callable[[argparse.Namespace], int] = arguments.command
        code = command(arguments)
        sys.stdout.flush()
        return code
    except AuvMcmError as error:
        return _fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _fail("interrupted", _INTERRUPTED)
    except ModuleNotFoundError as error:
        return _missing(error)
    except ExceptionGroup as group:
        missing = group.subgroup(ModuleNotFoundError)
        if missing is None:
            raise
        return _missing(first_of(missing))
    except BrokenPipeError:
        # Whoever read our output, such as head, has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        remedy = f". {_REMEDIES[error.errno]}" if error.errno in _REMEDIES else ""
        text = f"{error.filename or 'input or output'}: {error.strerror or error}{remedy}"
        return _fail(text, HardwareError.exit_code)


def _fill_closed_streams() -> None:
    """Open a closed input or output on nothing, where the next file, as a recording, would get what is printed."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free
            raw = io.FileIO(number, "r+", closefd=False)
            stream = io.BufferedReader(raw) if name == "stdin" else io.BufferedWriter(raw)
            setattr(sys, name, io.TextIOWrapper(stream, line_buffering=True))


def _missing(error: Exception) -> int:
    """Say how to install a package that is missing. Raises the error again for a module of our own, which is a
    defect."""
    package = (getattr(error, "name", None) or "").partition(".")[0]
    if package in ("", "auv_mcm", "drivers", "sim_replay"):
        raise error
    extra = next((extra for extra, packages in _EXTRAS.items() if package in packages), None)
    if extra is not None:
        return _fail(
            f"this command needs the package {package}: python -m pip install 'auv-mcm[{extra}]'", UsageError.exit_code
        )
    return _fail(f"the package {package} is missing: python -m pip install auv-mcm", UsageError.exit_code)


def _fail(text: str, code: int) -> int:
    print(clean_lines(f"auv-mcm: {text}"), file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="auv-mcm",
        description=(
            "Payload service of a mine-hunting AUV: side-scan pings and navigation in, contacts, coverage and "
            "way-points out."
        ),
    )
    parser.add_argument("--version", action="version", version=f"auv-mcm {__version__}")
    has_bench = importlib.util.find_spec("sim_replay") is not None
    if has_bench:
        parser.add_argument(
            "--completion",
            choices=("bash", "zsh", "tcsh"),
            action=_Completion,
            help="print what completes it in a shell",
        )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, help=argparse.SUPPRESS)
    for name in COMMANDS.values():
        if has_bench or not name.startswith("sim_replay."):
            load(name)(commands)
    parser.epilog = _overview({action.dest: action.help or "" for action in commands._choices_actions})
    return parser


def _overview(helps: dict[str, str]) -> str:
    """List commands by purpose, and how to learn more."""
    width = max(map(len, helps)) + 2
    parts = [
        "\n".join([f"{title}:", *(f"  {name:{width}}{helps[name]}" for name in names if name in helps)])
        for title, names in COMMAND_GROUPS.items()
        if any(name in helps for name in names)
    ]
    return "\n\n".join([*parts, f"'auv-mcm COMMAND --help' explains a command. {EXIT_CODES}."])


class _Completion(argparse.Action):
    """Print a script that completes commands and options."""

    def __call__(self, parser: argparse.ArgumentParser, *values: Any, **options: Any) -> None:
        print(load(COMPLETION)(parser, values[1]))
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
