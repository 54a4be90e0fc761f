"""Replay a log and draw what was found.

    python replay_and_plot.py LOG OUT

LOG is anything that `auv-mcm replay` takes. OUT gets all result files of a replay, and map.png: the covered sea floor,
and each contact with its probability of being a mine.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")  # files instead of windows: works without a screen
from matplotlib import pyplot as plt

from auv_mcm.settings.config import Config
from sim_replay.replay import replay


def main(log: Path, out: Path) -> None:
    """Replay a log and plot its contacts over the track."""
    # Every setting has a default. To use a file: auv_mcm.commands.read_config(Path("vehicle.yaml")).
    summary = replay([log], out, Config())
    print(f"{summary['pings']} pings, {summary['contacts']} contacts, {summary['covered_km2']:.4f} km² covered")

    # The result files are the interface: GeoJSON with longitude, latitude in degrees (WGS 84).
    contacts = json.loads((out / "contacts.geojson").read_text())["features"]
    coverage = json.loads((out / "coverage.geojson").read_text())["features"]

    figure, axes = plt.subplots(figsize=(8, 6), layout="constrained")
    for patch in coverage:
        for ring in rings(patch["geometry"]):
            axes.fill(ring[:, 0], ring[:, 1], color="0.85", linewidth=0)
    if contacts:
        places = np.array([contact["geometry"]["coordinates"][:2] for contact in contacts])
        p_mine = np.array([contact["properties"]["p_mine"] for contact in contacts])
        marks = axes.scatter(places[:, 0], places[:, 1], c=p_mine, cmap="viridis_r", vmin=0.0, vmax=1.0, edgecolors="k")
        figure.colorbar(marks, label="probability of a mine")
        for contact, place in zip(contacts, places, strict=True):
            if contact["properties"]["p_mine"] > 0.5:
                axes.annotate(contact["properties"]["class"], place, xytext=(5, 5), textcoords="offset points")
    axes.set_aspect(1.0 / np.cos(np.radians(np.mean(axes.get_ylim()))))  # a metre east is as long as a metre north
    axes.set(xlabel="longitude, degrees", ylabel="latitude, degrees", title=log.name)
    figure.savefig(out / "map.png", dpi=150)
    print(f"map: {out / 'map.png'}")


def rings(geometry: dict[str, Any]) -> list[NDArray[np.float64]]:
    """List the outlines of a GeoJSON polygon or multipolygon, each (n, 2): longitude, latitude in degrees."""
    coordinates = geometry["coordinates"]
    polygons = coordinates if geometry["type"] == "MultiPolygon" else [coordinates]
    return [np.array(ring) for polygon in polygons for ring in polygon]


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
