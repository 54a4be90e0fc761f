"""Read a fitted model that a configuration key names: the one that ships with the package, or a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from auv_mcm.errors import BadInputError
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import Config

SHIPPED: Final = "shipped"
NONE: Final = "none"
Model = TypeVar("Model")


def named_files(config: Config) -> dict[tuple[str, str], str]:
    """List the files that a configuration names in place of those that ship, by section and key."""
    given = msgspec.to_builtins(config)
    return {
        (section, key): given[section][key]
        for section, values in msgspec.to_builtins(Config()).items()
        if isinstance(values, dict)
        for key, value in values.items()
        if value == SHIPPED and given[section][key] not in (SHIPPED, NONE)
    }


def files_from(folder: Path, config: Config) -> Config:
    """Have the files that a configuration names begin from a folder, those named from the root left as they are."""
    for (section, key), name in named_files(config).items():
        part = msgspec.structs.replace(getattr(config, section), **{key: str(folder / name)})
        config = msgspec.structs.replace(config, **{section: part})
    return config


def read_model(
    key: str, name: str, parse: Callable[[bytes, str], Model], shipped: Callable[[], Model], else_: str = ""
) -> Model:
    """Read the model that a configuration key names: `shipped`, or the path of a file.

    Raises BadInputError naming key and file where it cannot be read, and as parse does.

    Parameters
    ----------
    key
        For messages, e.g. detect.model.
    parse
        Bytes and the place for messages to a model.
    else_
        For messages, other names that the key takes.
    """
    if name == SHIPPED:
        return shipped()
    try:
        data = read_regular(Path(name))
    except OSError as error:
        message = f"{key} {name}: {error.strerror}. Name a model file, or '{SHIPPED}' for the one of the package{else_}"
        raise BadInputError(message) from error
    except BadInputError as error:  # a pipe or a device
        raise BadInputError(f"{key} {error}") from error
    return parse(data, f"{key} {name}")
