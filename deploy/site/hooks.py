"""Let MkDocs build pages that are made from the code, so that none of them can be out of date."""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from deploy.site.pages import example_pages, project_pages, reference_pages


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the examples to the navigation, after the how-to pages."""
    examples = list(example_pages(Path(config.docs_dir)))
    if examples and config.nav is not None:
        titles = [next(iter(item)) if isinstance(item, dict) else "" for item in config.nav]
        config.nav.insert(titles.index("How to") + 1, {"Examples": ["examples.md", *examples]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from the code."""
    for path, text in {**reference_pages(), **example_pages(Path(config.docs_dir)), **project_pages()}.items():
        files.append(File.generated(config, path, content=text))
    files.append(File.generated(config, "css/site.css", abs_src_path=str(Path(__file__).with_name("site.css"))))
    return files
