"""Every code block of README, docs and project pages is executed, or read by what reads such a file; output is marked
as text."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
import yaml

from auv_mcm.classify.targets import parse_targets
from auv_mcm.settings.config import parse_config
from auv_mcm.settings.plugins import GROUPS
from auv_mcm.settings.strict_yaml import load_mapping
from drivers.ports import read_ports
from sim_replay.augment.targets import parse_target_spec
from sim_replay.fitting.cascade.spec import parse_training_spec
from sim_replay.hil.scenario import parse_scenario
from sim_replay.logs.image_sidecar import parse_sidecar
from sim_replay.simulator.scene_file import parse_scene
from tests.auv_mcm.test_command_lines import PAGES, PROGRAMS

OUTPUT: Final = "text"
EXAMPLES: Final = "python auv_mcm/docs/examples/"
LANGUAGES: Final = frozenset({"sh", "yaml", "toml", OUTPUT})


class Block(NamedTuple):
    """One fenced block. place: page and line."""

    place: str
    language: str
    text: str


def blocks_of(page: Path) -> list[Block]:
    """Find the fenced blocks of a page."""
    text = page.read_text("utf-8")
    found = re.finditer(r"^( *)```(\w*)\n(.*?)^\1```$", text, re.DOTALL | re.MULTILINE)
    return [Block(f"{page.name}, line {text[: one.start()].count(chr(10)) + 1}", one[2], one[3]) for one in found]


def parse_ports(text: str, place: str) -> None:
    read_ports(parse_config(text, place))


# What reads a YAML block, by a key that only such a file has.
READERS: Final[dict[str, Callable[[str, str], Any]]] = {
    "mines": parse_targets,
    "expectations": parse_scenario,
    "track": parse_scene,
    "scenes": parse_training_spec,
    "scatter": parse_target_spec,
    "targets": parse_target_spec,
    "ports": parse_ports,
    "near_edge": lambda text, place: parse_sidecar(load_mapping(text, place, "a sidecar"), place),
}

BLOCKS: Final = [block for page in PAGES for block in blocks_of(page)]


def marked(language: str) -> pytest.MarkDecorator:
    chosen = [block for block in BLOCKS if block.language == language]
    assert chosen, f"no block of {language} was found"
    return pytest.mark.parametrize("block", chosen, ids=lambda block: block.place)


def test_every_block_names_its_language() -> None:
    assert [block.place for block in BLOCKS if block.language not in LANGUAGES] == [], (
        f"name one of {', '.join(sorted(LANGUAGES))}"
    )


@marked("sh")
def test_every_line_of_a_shell_block_is_a_command_that_runs(block: Block) -> None:
    lines = [line.strip() for line in block.text.splitlines() if line.strip()]
    # test_command_lines.py runs these and no others, test_examples.py those of the examples.
    assert [line for line in lines if not line.startswith((*PROGRAMS, EXAMPLES, "#"))] == []


@marked("yaml")
def test_a_yaml_block_is_a_valid_file(block: Block) -> None:
    keys = yaml.safe_load(block.text)
    reader = next((READERS[key] for key in READERS if key in keys), parse_config)
    reader(block.text, block.place)


@marked("toml")
def test_a_toml_block_names_entry_points_of_this_project(block: Block) -> None:
    assert set(tomllib.loads(block.text)["project"]["entry-points"]) <= set(GROUPS.values())
