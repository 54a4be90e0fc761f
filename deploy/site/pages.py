"""Write the pages of the site that are made from the code: configuration, commands, notices, counters, health, wires,
examples."""

from __future__ import annotations

import argparse
import ast
import html
import inspect
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from auv_mcm.cli import _parser
from auv_mcm.commands import Parser
from auv_mcm.settings.config import Config, config_yaml
from auv_mcm.settings.key_words import port_keys
from auv_mcm.shell.health.record import GRAVITY, REASONS, VALUES
from auv_mcm.shell.health.text import metric_name
from auv_mcm.skips import SKIPS
from deploy.site.raised import ROOT, counted_names, notices_by_code, raised_notices
from drivers.describe import example_text, interface_text
from sim_replay.benches.every_stage.bench import read_every_stage, stage_history
from sim_replay.benches.run_time.results import POINT_HEADER, VERSION_HEADER, point_rows, read_results, version_cells
from sim_replay.commands.bench import BENCHES, opened
from sim_replay.report.report_words import MEANINGS
from sim_replay.text_tables import markdown

EXAMPLES: Final = Path("examples")
"""Folder of the examples below the documents."""
HISTORY: Final = ROOT / "auv_mcm" / "docs" / "benchmarks"
"""Folder of the results of `sh deploy/bench.sh`, a file per version."""
_HELP_COLUMNS: Final = "110"  # width of help texts, characters
_MADE: Final = "<!-- Made from the code as the site is built. -->\n"


def reference_pages() -> dict[str, str]:
    """Write the pages that are made from the code, by their path below the documents."""
    return {
        "reference/configuration.md": configuration_page(),
        "reference/commands.md": commands_page(),
        "reference/notices.md": notices_page(),
        "reference/counters.md": counters_page(),
        "reference/health.md": health_page(),
        "reference/wire-interfaces.md": wire_interfaces_page(),
        "benchmarks.md": benchmarks_page(),
    }


def configuration_page() -> str:
    """List every key of the configuration with its meaning, range and default."""
    lines = [
        *(f"{_MADE}# Configuration", ""),
        (
            "One YAML file. Every key may be left out; its default then holds. An unknown key, a wrong type "
            "and a value out of range are"
        ),
        (
            "rejected with the key's path. `auv-mcm config --write vehicle.yaml` writes a file with all keys, `auv-mcm "
            "check --config"
        ),
        "vehicle.yaml` checks one, `auv-mcm config --schema` prints a JSON Schema for editors.",
        "",
    ]
    for section, about, keys in _sections(config_yaml(Config())):
        lines += [f"## {section}", "", about, "", "| key | value | meaning |", "|---|---|---|", *keys, ""]
    lines += [
        "## Keys of a port",
        "",
        "Each entry of `ports:` has these keys; `auv-mcm run --example` prints a list to begin with.",
        "",
    ]
    lines += ["| key | value | meaning |", "|---|---|---|"]
    for line in port_keys():
        key, _, rest = line.partition(": ")
        value, _, meaning = rest.partition(" - ")
        lines.append(_row(f"`{key}`", value, meaning))
    return "\n".join(lines) + "\n"


def _sections(text: str) -> Iterator[tuple[str, str, list[str]]]:
    """Read the sections of the explained configuration: name, what it is for, and a row per key."""
    top: list[str] = []
    for block in text.split("\n\n")[1:]:
        lines = block.splitlines()
        if not lines[-1].startswith(" "):  # a key outside of any section
            top.append(_key_row("", *lines[-3:]))
            continue
        section, keys = lines[1].removesuffix(":"), lines[2:]
        rows = [_key_row(f"{section}.", *keys[at : at + 3]) for at in range(0, len(keys), 3)]
        yield section, lines[0].removeprefix("# "), rows
    yield "Outside of sections", "", top


def _key_row(section: str, meaning: str, value: str, key: str) -> str:
    return _row(f"`{section}{key.strip().partition(':')[0]}`", value.strip(" #"), meaning.strip(" #"))


def commands_page() -> str:
    """Print the help of every command and bench."""
    lines = [f"{_MADE}# Commands", "", "What `--help` prints.", ""]
    with _wide_help():
        for parser in _parsers(_parser()):
            lines += [f"## {parser.prog}", "", "```text", parser.format_help().rstrip(), "```", ""]
        for name, (module, does) in BENCHES.items():
            parser = Parser(prog=f"auv-mcm bench {name}", description=f"Measure: {does}.")
            opened(module, parser)
            lines += [f"### {parser.prog}", "", "```text", parser.format_help().rstrip(), "```", ""]
    return "\n".join(lines)


def _parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Go through a parser and those of all its subcommands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in dict.fromkeys(action.choices.values()):
                yield from _parsers(below)


@contextmanager
def _wide_help() -> Iterator[None]:
    """Format help for a page instead of the terminal."""
    before = {name: os.environ.get(name) for name in ("COLUMNS", "NO_COLOR")}
    os.environ.update(COLUMNS=_HELP_COLUMNS, NO_COLOR="1")
    yield
    for name, value in before.items():
        if value is None:
            del os.environ[name]
        else:
            os.environ[name] = value


def notices_page() -> str:
    """List every notice by its code, with its text, which says what to do."""
    lines = [
        *(f"{_MADE}# Notices", ""),
        (
            "A notice asks a person to do something. It stands among the `notices` of `summary.json`, in "
            "the report and in the"
        ),
        (
            "service's log. A *remark* asks for nothing: it stands among the `remarks`. Codes are stable, for scripts; "
            "texts are not."
        ),
        "A name in italics stands for a value, a stroke between two texts for one or the other.",
        "",
    ]
    for code, notices in notices_by_code(raised_notices()).items():
        flags = {notice.for_the_record for notice in notices}
        kind = (
            "Remark."
            if flags == {True}
            else "Notice."
            if flags == {False}
            else "Notice, or a remark where nobody has to do anything."
        )
        lines += [f"## {code}", "", f"{kind} Raised in `{notices[0].module}`.", ""]
        lines += [f"> {_plain(notice.text)}\n" for notice in notices]
    return "\n".join(lines)


def counters_page() -> str:
    """List every counter of summary.json with its meaning."""
    lines = [
        *(f"{_MADE}# Counters", ""),
        (
            "`counters` of `summary.json` state how often data was rejected, skipped or degraded, and how "
            "much work was done. Only"
        ),
        "counters above 0 are there. A name in angle brackets stands for a value. What `drivers/` counts at a port has",
        "`port.NAME.` before it.",
        "",
        "| counter | meaning | counted in |",
        "|---|---|---|",
    ]
    for name, modules in _counters().items():
        lines.append(_row(f"`{name}`", _meaning(name), ", ".join(f"`{module}`" for module in modules)))
    return "\n".join(lines) + "\n"


def health_page() -> str:
    """List every reason and every value of a record of health with its meaning."""
    lines = [
        *(f"{_MADE}# Health", ""),
        "`health.json` is one JSON object on one line: `state` of the whole, that of its worst part; `version`,",
        "`session`, `utc_s`, `period_s` until the next record; and `parts`, each with `name`, `state`, `reasons`,",
        "`words` for people and `values`. In the order of their gravity, states are "
        + ", ".join(f"`{state}`" for state in GRAVITY)
        + ".",
        "`/metrics` has the same for Prometheus. [How to watch it](../how-to/watch-the-payload.md).",
        *("", "## Parts", ""),
        "`service`, `perception`, `port.NAME`, `navigation.QUANTITY`, `recording`, `vehicle`, `disk`, `computer`;",
        "those that a configuration has no use for are absent.",
        *("", "## Reasons", "", "| reason | meaning, and what to do |", "|---|---|"),
        *(_row(f"`{reason}`", meaning) for reason, meaning in REASONS.items()),
        *("", "## Values", "", "| value | for Prometheus | meaning |", "|---|---|---|"),
        *(_row(f"`{name}`", f"`auv_mcm_{metric_name(name)}`", meaning) for name, meaning in VALUES.items()),
    ]
    return "\n".join(lines) + "\n"


def _counters() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for counted in counted_names():
        found.setdefault(counted.name, []).append(counted.module)
    return found


def _meaning(name: str) -> str:
    """Find what a counter means to a person; its last word where nobody wrote that down."""
    general = re.sub(r"<side>_", "", name)
    meanings = {skip.counter: f"{skip.leaves_out}: {skip.because}" for skip in SKIPS} | MEANINGS
    if general in meanings:
        return meanings[general]
    return meanings.get(name.rpartition(".")[0], "") or name.rpartition(".")[2].replace("_", " ").replace(
        "<", "*"
    ).replace(">", "*")


def wire_interfaces_page() -> str:
    """Print every message in and out of every device, and an example of ports."""
    return "\n".join(
        [
            *(f"{_MADE}# Wire interfaces", ""),
            (
                "What `auv-mcm run --interface` prints without ports: links and devices, and each device's messages to "
                "the byte. With"
            ),
            "`--config vehicle.yaml` it prints those of that vehicle, with the commands that the payload sends.",
            *("", "```text", interface_text(Config()).rstrip(), "```", ""),
            *("## Example of ports", "", "What `auv-mcm run --example` prints, without its list of keys.", ""),
            *("```yaml", example_text().partition("\n# All keys of a port:")[0].rstrip(), "```", ""),
        ]
    )


def benchmarks_page(history: Path = HISTORY) -> str:
    """Tabulate what each version's run of the bench found, the newest version first."""
    lines = [
        *(f"{_MADE}# Benchmark history", ""),
        (
            "Run time against error of each version on the same two simulated missions, beside a plain script "
            "in the same run. `sh"
        ),
        (
            "deploy/bench.sh` measures this version, says what moved beyond noise since the one before, and keeps the "
            "result. Compare"
        ),
        "the ratio to the plain script: computers differ and are busy. [More points and targets](results.md#run-time).",
        "",
    ]
    found = {path.stem: read_results(path) for path in _by_version(history)}
    lines += ["## Versions", "", "Those released, and the one in the making, at the default operating point.", ""]
    lines += [markdown(VERSION_HEADER, [[version, *version_cells(run)] for version, run in found.items()]), ""]
    stages = {path.stem: read_every_stage(path) for path in _by_version(history / "stages")}
    if stages:
        lines += [
            "Of each stage at its last setting: time in units of [the alternative](results.md#run-time), error of",
            "both, and the error's unit. A dash stands for what was not measured. pyxtf's time ends where it fails.",
            "",
            markdown(("stage", *stages), stage_history(list(stages.values()))),
            "",
        ]
    for version, results in found.items():
        machine = results.machine
        lines += [f"## {version}", ""]
        lines.append(
            f"{machine.date}, {machine.processor}, {machine.cores} cores, kernels {machine.kernels}; "
            f"{', '.join(results.missions)};"
        )
        lines += [f"medians of {results.repeat} repeats.", "", markdown(POINT_HEADER, point_rows(results)), ""]
    return "\n".join(lines)


def _by_version(folder: Path) -> list[Path]:
    """List results of versions, the newest first."""
    return sorted(folder.glob("*.json"), key=lambda path: [int(part) for part in path.stem.split(".")], reverse=True)


def example_pages(documents: Path) -> dict[str, str]:
    """Write a page for each example: its docstring, and its code. By path below the documents."""
    pages = {}
    for path in sorted((documents / EXAMPLES).glob("*.py")):
        source = path.read_text("utf-8")
        about = inspect.cleandoc(ast.get_docstring(ast.parse(source)) or "")
        title = path.stem.replace("_", " ").capitalize()
        text = (
            f"{_MADE}# {title}\n\n{about}\n\nThe file: "
            f"`auv_mcm/docs/examples/{path.name}`.\n\n```python\n{source.rstrip()}\n```\n"
        )
        pages[(EXAMPLES / f"{path.stem}.md").as_posix()] = text
    return pages


def project_pages() -> dict[str, str]:
    """Take the pages at the top of the project into the site, with links that hold there."""
    pages = {}
    for name in ("CONTRIBUTING", "SECURITY", "CHANGELOG"):
        text = (ROOT / f"{name}.md").read_text("utf-8").replace("](auv_mcm/docs/", "](../")
        pages[f"project/{name.lower()}.md"] = re.sub(
            r"\]\((CONTRIBUTING|SECURITY|CHANGELOG)\.md", lambda match: f"]({match[1].lower()}.md", text
        )
    return pages


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _plain(text: str) -> str:
    """Escape what Markdown would take for markup, but for names in italics."""
    return html.escape(text, quote=False).replace("_", "\\_").replace("[", "\\[")
