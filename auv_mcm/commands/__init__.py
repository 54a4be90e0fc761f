"""Define the subcommands of the payload, a module each, and what all share; heavy imports happen when they run."""

from __future__ import annotations

import argparse
import difflib
import json
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from auv_mcm.clean_text import clean_json, clean_lines, tinted
from auv_mcm.errors import UsageError

if TYPE_CHECKING:
    from auv_mcm.settings.config import Config

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
Namespace = TypeVar("Namespace")

_WIDTH: Final = 100  # columns; longer lines are hard to follow (chosen)
_LIST: Final = re.compile(r"^\S+: {2,}", re.MULTILINE)

EXIT_CODES: Final = (
    "exit codes: 0 done, 2 bad usage or configuration, 3 bad input data, 4 hardware or link failed, 5 self-check failed"
)


class HelpText(argparse.HelpFormatter):
    """Fit help to the width of the terminal, paragraph by paragraph; indented lines stay as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        def filled(paragraph: str) -> str:
            if any(line.startswith("  ") for line in paragraph.splitlines()):
                return "\n".join(indent + line for line in paragraph.splitlines())
            if _LIST.search(paragraph):
                return "\n".join(_hung(line, width, indent) for line in paragraph.splitlines())
            return textwrap.fill(" ".join(paragraph.split()), width, initial_indent=indent, subsequent_indent=indent)

        return "\n\n".join(map(filled, text.split("\n\n")))


def _hung(line: str, width: int, indent: str) -> str:
    """Wrap an item of a list, so that its words stand below one another."""
    name = _LIST.match(line)
    behind = indent + " " * (name.end() if name else 0)
    return textwrap.fill(line, width, initial_indent=indent, subsequent_indent=behind)


class Parser(argparse.ArgumentParser):
    """Reject arguments that a command does not have with that command's own usage and the nearest option.

    argparse hands what a subcommand does not know back to the main parser, which then prints its own usage. It would
    also take the beginning of an option for the whole: a slip such as `train --ou x` would train for minutes.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"allow_abbrev": False, "formatter_class": HelpText, **options})

    def parse_known_args(  # type: ignore[override]  # argparse overloads it; here it is called by argparse alone
        self, args: Sequence[str] | None = None, namespace: Namespace | None = None
    ) -> tuple[Namespace | argparse.Namespace, list[str]]:
        """Parse arguments; report bad usage with exit code 2."""
        parsed, unknown = super().parse_known_args(args, namespace)
        if unknown:
            near = difflib.get_close_matches(unknown[0].partition("=")[0], self._option_string_actions, n=1)
            self.error(f"unrecognized arguments: {' '.join(unknown)}" + (f"; did you mean {near[0]}?" if near else ""))
        return parsed, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Reject a value that is no choice, and name the nearest one."""
        if action.choices is None or value in action.choices:
            return
        choices = [str(choice) for choice in action.choices]
        near = difflib.get_close_matches(str(value), choices, n=1)
        hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(choices)}"
        raise argparse.ArgumentError(action, f"there is no '{value}'; {hint}")


def command(commands: Commands, name: str, does: str, more: str, examples: Sequence[str]) -> argparse.ArgumentParser:
    """Add a subcommand; return its parser.

    Parameters
    ----------
    does
        What it does, in a few words.
    more
        The same in full: paragraphs, which are wrapped, and lists, a `name:  words` to a line, which are kept.
    examples
        Command lines that work.
    """
    return commands.add_parser(
        name,
        help=does,
        description=f"{does[0].upper()}{does[1:]}.\n\n{_wrapped(more)}",
        epilog="examples:\n" + "\n".join(f"  {example}" for example in examples) + f"\n\n{EXIT_CODES}",
    )


def _wrapped(text: str) -> str:
    """Wrap paragraphs to the terminal, and to a width that is easy to read."""
    width = min(max(shutil.get_terminal_size().columns - 2, 1), _WIDTH)
    return "\n\n".join(
        paragraph if _LIST.search(paragraph) else textwrap.fill(" ".join(paragraph.split()), width)
        for paragraph in text.split("\n\n")
    )


CONFIG: Final[tuple[str, dict[str, Any]]] = (
    "--config",
    {"metavar": "FILE", "type": Path, "help": "configuration in YAML; see 'auv-mcm config --write'"},
)
"""The option of a configuration, as `add_argument` takes it."""


def add_config_option(parser: argparse.ArgumentParser) -> None:
    """Add `--config` to a command."""
    name, how = CONFIG
    parser.add_argument(name, **how)


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add `--json` to a command: what came of it as JSON on standard output, and nothing else there."""
    parser.add_argument(
        "--json", action="store_true", help="print what came of it as JSON and nothing else, for scripts"
    )


def answer(found: Mapping[str, Any], words: Sequence[str], *, as_json: bool) -> None:
    """Print what a command found: as one object of JSON, paths as text and no NaN, or in words, a line each."""
    from auv_mcm.shell.whole_files import finite

    if as_json:
        print(clean_json(json.dumps(finite(found), default=str, ensure_ascii=False)), flush=True)
        return
    for line in words:
        shown = clean_lines(line)
        print(tinted(shown, "yellow") if shown.startswith(("notice:", "failed:")) else shown)


def whole(low: int, high: int) -> Callable[[str], int]:
    """Make a parser of whole numbers from low to high."""

    def parse(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = low - 1
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return number

    return parse


def read_config(path: Path | None) -> Config:
    """Read the configuration in a file, or the defaults. Files that it names are looked for from its own folder.

    Raises UsageError for a file that cannot be read or is not valid.
    """
    from auv_mcm.model_file import files_from
    from auv_mcm.settings.config import Config, parse_config
    from auv_mcm.settings.strict_yaml import read_text

    if path is None:
        return Config()
    config = files_from(path.parent.absolute(), parse_config(read_text(path, "configuration"), str(path)))
    if config.ports:
        from auv_mcm.shell.registry import READ_PORTS, load

        try:
            load(READ_PORTS)(config)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from error
    return config


def write_new(path: Path, text: str) -> None:
    """Write text to a file that is not there yet, and say so. Raises UsageError if it is, or cannot be written."""
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise UsageError(f"{path} exists and is not overwritten: name a new file, or remove it") from error
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error
    print(f"written: {path}")


class Progress:
    """Show progress: a bar on a terminal, a plain line every tenth elsewhere; both on standard error."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._tenths = 0
        self._update: Callable[[float], None] = self._print_tenths
        self._close: Callable[[], None] = lambda: None

    def __enter__(self) -> Progress:
        if sys.stderr.isatty():
            try:
                from rich.console import Console
                from rich.progress import Progress
            except ImportError:
                return self
            bar = Progress(console=Console(stderr=True), transient=True)
            task = bar.add_task(self._title, total=1.0)
            bar.start()
            self._update = lambda fraction: bar.update(task, completed=fraction)
            self._close = bar.stop
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def show(self, fraction: float) -> None:
        """Show how much is done. fraction: 0 to 1."""
        self._update(fraction)

    def _print_tenths(self, fraction: float) -> None:
        if int(fraction * 10.0) > self._tenths:
            self._tenths = int(fraction * 10.0)
            print(f"{self._title}: {10 * self._tenths} %", file=sys.stderr, flush=True)
