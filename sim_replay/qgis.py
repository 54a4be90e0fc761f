"""Lay mosaic, contacts, coverage and plans out as a QGIS project, and style contacts by how likely a mine they are.

A project is XML as QGIS 3.22 and later read it, and names its files relative to itself: move the folder, and it opens.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from auv_mcm.clean_text import clean
from auv_mcm.contacts.contact_picture import CEILING_DB, FLOOR_DB
from auv_mcm.contacts.contact_words import LEVELS
from auv_mcm.errors import UsageError
from auv_mcm.shell.whole_files import write_file
from sim_replay.mosaic import WGS84, Box

_VERSION: Final = "3.22.0"
_COLOURS: Final = ("211,18,63,255", "217,122,8,255", "47,134,166,255", "135,148,157,255")
"""Of the levels of p_mine, as in the report: red, green, blue, opacity."""
_LOOKS: Final = {
    "structures": ("fill", {"color": "211,18,63,40", "outline_color": "211,18,63,255"}),
    "clearance": ("fill", {"color": "120,94,240,40", "outline_style": "no"}),
    "coverage": ("fill", {"color": "63,150,150,50", "outline_style": "no"}),
    "second_views": ("line", {"line_color": "217,122,8,255", "line_width": "0.6"}),
    "survey_legs": ("line", {"line_color": "47,134,166,255", "line_width": "0.6"}),
    "track": ("line", {"line_color": "36,81,94,255", "line_width": "0.3"}),
}
_POINT: Final = ("marker", {"name": "cross", "color": "0,0,0,255", "size": "2"})
_CLASSES: Final = {"marker": "SimpleMarker", "line": "SimpleLine", "fill": "SimpleFill"}
_GEOMETRY: Final = {"marker": "Point", "line": "Line", "fill": "Polygon"}
_BELOW: Final = ("track", "clearance", "coverage")  # layers below all others, but above the mosaic

Feature = Mapping[str, Any]


def contact_style() -> str:
    """Write the style of contacts, a colour for each level of p_mine, as QGIS keeps it (QML)."""
    style = Element("qgis", styleCategories="Symbology", version=_VERSION)
    style.append(_contact_renderer())
    return '<!DOCTYPE qgis PUBLIC "http://mrcc.com/qgis.dtd" "SYSTEM">' + tostring(style, encoding="unicode")


def write_project(
    path: Path,
    mosaics: Sequence[Path],
    layers: Mapping[str, Sequence[Feature]],
    geopackage: Path,
    name: str,
    outline: Box,
    epsg: int = WGS84,
    is_coloured: bool = False,
) -> None:
    """Write a project that shows the mosaic below the layers of the GeoPackage. Raises OSError or UsageError.

    Parameters
    ----------
    path
        Of the project, .qgs.
    mosaics, geopackage
        The files that it shows.
    layers
        Those of the GeoPackage; empty ones are left out.
    name
        Of the mission.
    outline
        What is shown at first, in the mosaic's reference system.
    epsg
        Code of that system.
    is_coloured
        Whether the mosaic has colours instead of figures.
    """
    project = Element("qgis", projectname=clean(name), version=_VERSION)
    SubElement(project, "title").text = clean(name)
    project.append(_reference("projectCrs", epsg))
    canvas = SubElement(project, "mapcanvas", name="theMapCanvas")
    SubElement(canvas, "units").text = "degrees" if epsg == WGS84 else "meters"
    corners = {"xmin": outline.west, "ymin": outline.south, "xmax": outline.east, "ymax": outline.north}
    extent = SubElement(canvas, "extent")
    for corner, value in corners.items():
        SubElement(extent, corner).text = repr(value)
    canvas.append(_reference("destinationsrs", epsg))
    tree, kept = SubElement(project, "layer-tree-group"), SubElement(project, "projectlayers")
    for each in [*_vectors(layers, geopackage, path), *_rasters(mosaics, path, epsg, is_coloured)]:
        kept.append(each)
        words = {key: each.findtext(of) or "" for key, of in (("id", "id"), ("source", "datasource"))}
        SubElement(
            tree,
            "layer-tree-layer",
            words,
            name=each.findtext("layername") or "",
            checked="Qt::Checked",
            expanded="0",
            providerKey=each.findtext("provider") or "",
        )
    SubElement(SubElement(SubElement(project, "properties"), "Paths"), "Absolute", type="bool").text = "false"
    indent(project)
    text = tostring(project, encoding="unicode")
    write_file(path, f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{text}\n".encode())


def _vectors(layers: Mapping[str, Sequence[Feature]], geopackage: Path, project: Path) -> Iterator[Element]:
    names = [name for name, features in layers.items() if any(one["geometry"] for one in features)]
    for name in sorted(names, key=lambda each: (_BELOW.index(each) + 1 if each in _BELOW else 0, names.index(each))):
        kind, look = _LOOKS.get(name, _POINT)
        layer = _layer("vector", name, f"{_relative(geopackage, project)}|layername={name}", "ogr", WGS84)
        layer.set("geometry", _GEOMETRY[kind])
        layer.append(_contact_renderer() if name == "contacts" else _one_symbol(kind, look))
        yield layer


def _rasters(mosaics: Sequence[Path], project: Path, epsg: int, is_coloured: bool) -> Iterator[Element]:
    for number, mosaic in enumerate(mosaics, 1):
        name = "mosaic" if len(mosaics) == 1 else f"leg {number}"
        layer = _layer("raster", name, _relative(mosaic, project), "gdal", epsg)
        if is_coloured:
            look = {"type": "multibandcolor", "redBand": "1", "greenBand": "2", "blueBand": "3", "alphaBand": "4"}
            SubElement(SubElement(layer, "pipe"), "rasterrenderer", look, opacity="1")
        else:
            look = {"type": "singlebandgray", "grayBand": "1", "alphaBand": "-1", "gradient": "BlackToWhite"}
            renderer = SubElement(SubElement(layer, "pipe"), "rasterrenderer", look, opacity="1")
            stretch = SubElement(renderer, "contrastEnhancement")
            for key, value in (
                ("minValue", FLOOR_DB),
                ("maxValue", CEILING_DB),
                ("algorithm", "StretchToMinimumMaximum"),
            ):
                SubElement(stretch, key).text = str(value)
        yield layer


def _layer(kind: str, name: str, source: str, provider: str, epsg: int) -> Element:
    layer = Element("maplayer", type=kind)
    for key, value in (("id", f"auv_mcm_{name.replace(' ', '_')}"), ("datasource", source), ("layername", name)):
        SubElement(layer, key).text = value
    SubElement(layer, "provider").text = provider
    layer.append(_reference("srs", epsg))
    return layer


def _reference(tag: str, epsg: int) -> Element:
    outer = Element(tag)
    system = SubElement(outer, "spatialrefsys")
    SubElement(system, "srid").text = str(epsg)
    SubElement(system, "authid").text = f"EPSG:{epsg}"
    return outer


def _relative(target: Path, project: Path) -> str:
    relative = os.path.relpath(target.absolute(), project.absolute().parent).replace(os.sep, "/")
    if clean(relative) != relative:
        raise UsageError(f"{target} has a name that no QGIS project can hold. Rename it, or its folder")
    return relative if relative.startswith("../") else f"./{relative}"


def _contact_renderer() -> Element:
    renderer = Element("renderer-v2", type="RuleRenderer", symbollevels="0")
    rules, symbols = SubElement(renderer, "rules", key="levels"), SubElement(renderer, "symbols")
    upper = ""
    for number, ((minimum, words), colour) in enumerate(zip(LEVELS, _COLOURS, strict=True)):
        key = str(number)
        SubElement(rules, "rule", key=key, symbol=key, label=words, filter=f'"p_mine" >= {minimum}{upper}')
        upper = f' AND "p_mine" < {minimum}'
        look = {"name": "circle", "color": colour, "outline_color": "0,0,0,255", "size": "3" if number < 2 else "2"}
        symbols.append(_symbol("marker", look, key))
    return renderer


def _one_symbol(kind: str, look: Mapping[str, str]) -> Element:
    renderer = Element("renderer-v2", type="singleSymbol", symbollevels="0")
    SubElement(renderer, "symbols").append(_symbol(kind, look, "0"))
    return renderer


def _symbol(kind: str, look: Mapping[str, str], name: str) -> Element:
    symbol = Element("symbol", type=kind, name=name, alpha="1")
    layer = SubElement(symbol, "layer", {"class": _CLASSES[kind]}, enabled="1")
    options = SubElement(layer, "Option", type="Map")
    for key, value in look.items():
        SubElement(options, "Option", type="QString", name=key, value=value)
    return symbol
