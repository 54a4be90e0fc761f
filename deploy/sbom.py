"""Write the bill of materials of a folder of wheels, from their own metadata: python deploy/sbom.py WHEELS >SBOM.json.

CycloneDX 1.6 in JSON, of the standard library alone. Equal wheels give equal bytes: there is no time in it, and its
number follows from the wheels' checksums.
"""

from __future__ import annotations

import email
import hashlib
import json
import re
import sys
import uuid
import zipfile
from email.message import Message
from pathlib import Path
from typing import Any, NamedTuple

_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9._-]*[A-Za-z0-9])?")  # at the start of a requirement (PEP 508)


class Wheel(NamedTuple):
    """Hold a wheel's metadata and the checksum of its file, in hexadecimal."""

    metadata: Message
    sha256: str

    @property
    def name(self) -> str:
        """Return the name as package indexes write it (PEP 503)."""
        return normalised(self.metadata["Name"])

    @property
    def reference(self) -> str:
        """Return the package URL (purl)."""
        return f"pkg:pypi/{self.name}@{self.metadata['Version']}"


def normalised(name: str) -> str:
    """Write a package's name as indexes do (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def read_wheel(path: Path) -> Wheel:
    """Read the metadata of a wheel. Raises OSError, and ValueError for a file that is none."""
    with zipfile.ZipFile(path) as archive:
        found = [name for name in archive.namelist() if re.fullmatch(r"[^/]+\.dist-info/METADATA", name)]
        if len(found) != 1:
            raise ValueError(f"{path} is no wheel: it has {len(found)} files of metadata")
        metadata = email.message_from_bytes(archive.read(found[0]))
    return Wheel(metadata, hashlib.sha256(path.read_bytes()).hexdigest())


def bill_of_materials(folder: Path) -> dict[str, Any]:
    """Describe every wheel in a folder: name, version, checksum, licence, and what it needs of the others.

    Raises OSError and ValueError as `read_wheel` does, also for a folder without wheels.
    """
    wheels = sorted(map(read_wheel, folder.glob("*.whl")), key=lambda wheel: wheel.reference)
    if not wheels:
        raise ValueError(f"{folder} holds no wheel")
    references = {wheel.name: wheel.reference for wheel in wheels}
    content = "".join(f"{wheel.reference} {wheel.sha256}\n" for wheel in wheels)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, content)}",
        "version": 1,
        "components": [_component(wheel) for wheel in wheels],
        "dependencies": [
            {
                "ref": wheel.reference,
                "dependsOn": sorted({references[name] for name in _needed(wheel) if name in references}),
            }
            for wheel in wheels
        ],
    }


def _component(wheel: Wheel) -> dict[str, Any]:
    component: dict[str, Any] = {
        "type": "library",
        "bom-ref": wheel.reference,
        "name": wheel.name,
        "version": wheel.metadata["Version"],
        "purl": wheel.reference,
        "hashes": [{"alg": "SHA-256", "content": wheel.sha256}],
    }
    classified = [text for text in wheel.metadata.get_all("Classifier", []) if text.startswith("License ::")]
    if expression := wheel.metadata["License-Expression"]:
        component["licenses"] = [{"expression": expression}]
    elif classified:
        component["licenses"] = [{"license": {"name": text.rpartition(" :: ")[2]}} for text in classified]
    elif (text := wheel.metadata["License"]) and "\n" not in text:
        component["licenses"] = [{"license": {"name": text}}]
    return component


def _needed(wheel: Wheel) -> set[str]:
    """List what a wheel needs, extras included: only what lies beside it is kept of that."""
    found = (_NAME.match(text) for text in wheel.metadata.get_all("Requires-Dist", []))
    return {normalised(match[0]) for match in found if match is not None}


def main(folder: Path) -> int:
    """Print the bill of materials; returns the exit code."""
    try:
        bill = bill_of_materials(folder)
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        print(f"sbom: {error}", file=sys.stderr)
        return 1
    print(json.dumps(bill, indent=1, sort_keys=True))
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])) if len(sys.argv) == 2 else __doc__)
