"""Look a bill of materials up in a database of weaknesses, without a network: python deploy/audit.py SBOM.json OSV.zip.

OSV.zip is the database of osv.dev for PyPI, one file, which is fetched where there is a network:
https://osv-vulnerabilities.storage.googleapis.com/PyPI/all.zip. Every entry lists the versions that it affects, so that
none has to be compared. Prints each match and ends with 1 if there is one, with 2 if nothing could be looked up.
"""

from __future__ import annotations

import json
import re
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def weaknesses(bill: dict[str, Any], database: Path) -> Iterator[str]:
    """Yield a line for every entry that names a component in its version; withdrawn entries are left out."""
    used = {part["name"]: part["version"] for part in bill["components"]}
    with zipfile.ZipFile(database) as archive:
        for name in sorted(archive.namelist()):
            entry = json.loads(archive.read(name))
            if "withdrawn" in entry:
                continue
            for affected in entry.get("affected", []):
                package = affected.get("package", {})
                component = re.sub(r"[-_.]+", "-", package.get("name", "")).lower()  # as indexes write it (PEP 503)
                if package.get("ecosystem") == "PyPI" and used.get(component) in affected.get("versions", []):
                    known_as = ", ".join([entry["id"], *entry.get("aliases", [])])
                    yield f"{component} {used[component]}: {known_as}: {entry.get('summary', 'see osv.dev')}"


def main(bill: Path, database: Path) -> int:
    """Print the matches; returns the exit code."""
    try:
        found = sorted(set(weaknesses(json.loads(bill.read_bytes()), database)))
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        print(f"audit: nothing was looked up: {error}", file=sys.stderr)
        return 2
    for line in found:
        print(line)
    print(f"audit: {len(found)} known weaknesses in {bill}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])) if len(sys.argv) == 3 else __doc__)
