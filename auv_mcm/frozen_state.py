"""Turn the state of a chain into bytes and back, so that another process goes on exactly where this one was.

The bytes are a pickle in which what is large and does not change, such as models, stands by name. What is read back may
be made of this package's own stages and of a few plain types alone, so that a file that somebody else wrote cannot have
other code run.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from typing import Any, Final

_PROTOCOL: Final = 5  # of pickle: the first that writes arrays without copying them
_PLAIN: Final = {
    "auv_mcm.geometry.fix": {"chord_m", "reach_m"},  # by which fixes are compared
    "array": {"array", "_array_reconstructor"},
    "builtins": {"bytearray", "complex", "frozenset", "range", "set", "slice"},
    "collections": {"Counter", "OrderedDict", "deque", "defaultdict"},
    "msgspec._core": {"rebuild"},
    "msgspec._utils": {"rebuild"},
    "numpy": {"dtype", "ndarray"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.numeric": {"_frombuffer"},
    "numpy.core.multiarray": {"_reconstruct", "scalar"},
    "numpy.core.numeric": {"_frombuffer"},
}
_OWN: Final = "auv_mcm."
_NOT_STAGES: Final = ("auv_mcm.shell", "auv_mcm.commands")  # what opens files


class StateError(ValueError):
    """Report bytes that hold no state of this version."""


def freeze(state: Any, constants: Mapping[str, object]) -> bytes:
    """Turn a state into bytes.

    Parameters
    ----------
    constants
        Objects within the state that stand in the bytes by their name, compared by identity.
    """
    out = io.BytesIO()
    _Freezer(out, constants).dump(state)
    return out.getvalue()


def thaw(data: bytes, constants: Mapping[str, object]) -> Any:
    """Read a state back, with the constants of this process. Raises StateError."""
    try:
        return _Thawer(io.BytesIO(data), constants).load()
    except StateError:
        raise
    except Exception as error:  # bytes that are damaged or of another version fail in any way
        raise StateError(f"the state cannot be read: {type(error).__name__}: {error}") from error


class _Freezer(pickle.Pickler):
    def __init__(self, out: io.BytesIO, constants: Mapping[str, object]) -> None:
        super().__init__(out, _PROTOCOL)
        self._names = {id(constant): name for name, constant in constants.items() if constant is not None}

    def persistent_id(self, obj: Any) -> str | None:
        return self._names.get(id(obj))


class _Thawer(pickle.Unpickler):
    def __init__(self, data: io.BytesIO, constants: Mapping[str, object]) -> None:
        super().__init__(data)
        self._constants = constants

    def persistent_load(self, pid: Any) -> object:
        if self._constants.get(pid) is None:
            raise StateError(f"the state needs '{pid}', which is not there")
        return self._constants[pid]

    def find_class(self, module: str, name: str) -> Any:
        if "." not in name:
            if name in _PLAIN.get(module, ()):
                return super().find_class(module, name)
            if module.startswith(_OWN) and not module.startswith(_NOT_STAGES):
                found = super().find_class(module, name)
                if isinstance(found, type) and found.__module__.startswith(_OWN):
                    return found
        raise StateError(f"the state names {module}.{name}, which is no part of one")
