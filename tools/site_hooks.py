"""Hooks of mkdocs: files outside docs/ that pages link to are pages of the site, too, and the links lead there.

A text in Markdown is a page as it stands, any other text is shown as code, and a folder as the list of its files. So
one and the same link works on a code forge and in the site.
"""

from __future__ import annotations

import os.path
import posixpath
import re
from collections.abc import Sequence
from importlib.resources import files as files_of_package
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

import sal_height

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

FOLDER = "repository"
"""Folder of the site for files outside docs/."""

ALWAYS = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")
"""Pages of the site whether or not they are linked to."""

LINK = re.compile(r"(?<=\]\()(?P<path>[^)#:\s]+)(?P<heading>#[^)\s]*)?(?=\))")
"""Target of a link or picture of this host, in Markdown."""

LANGUAGES = {".c": "c", ".json": "json", ".py": "python", ".rviz": "yaml", ".xml": "xml", ".yaml": "yaml"}
"""Language that the text of a file is coloured as, by the end of its name."""

MERMAID = "javascripts/mermaid.min.js"
"""The script that draws diagrams. Without it the theme takes it from another host."""


NOTEBOOKS = ROOT / "out" / "notebooks"
"""Executed notebooks, as `make notebooks` writes them: NAME.html, and NAME.png with the last picture."""


def on_config(config: MkDocsConfig, **_: Any) -> MkDocsConfig:
    """Show the version beside the name."""
    config.site_name = f"{config.site_name} {sal_height.__version__}"
    return config


def on_files(files: Files, *, config: MkDocsConfig, **_: Any) -> Files:
    """Add what pages link to, what those pages link to in turn, and the script for diagrams."""
    script = files_of_package("mermaidx") / "assets" / "mermaid.js"
    files.append(File.generated(config, MERMAID, abs_src_path=str(script)))
    for path in executed_notebooks():
        for shown in (path, path.with_suffix(".png")):
            files.append(File.generated(config, f"notebooks/{shown.name}", abs_src_path=str(shown)))
    waiting = [*(ROOT / name for name in ALWAYS), *(path for page in DOCS.rglob("*.md") for path in _linked(page))]
    shown: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in shown or path.is_relative_to(DOCS):
            continue
        shown.add(path)
        files.append(
            File.generated(config, _site_name(path), content=_content(path), inclusion=InclusionLevel.NOT_IN_NAV)
        )
        waiting += _linked(path)
    return files


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """Let links to files of the repository lead to their pages, and diagrams run down the narrow column of the site."""
    markdown = markdown.replace("```mermaid\nflowchart LR", "```mermaid\nflowchart TB")
    if page.file.src_uri == "notebooks.md":
        markdown += gallery(executed_notebooks())
    source = _source(page.file.src_uri)
    if not _has_links(source):
        return markdown

    def turned(link: re.Match[str]) -> str:
        path = _target(source, link["path"])
        if path is None:
            return link[0]
        return posixpath.relpath(_site_name(path), posixpath.dirname(page.file.src_uri)) + (link["heading"] or "")

    return LINK.sub(turned, markdown)


def on_page_content(html: str, *, page: Page, **_: Any) -> str:
    """Load the script for diagrams on pages that have one."""
    if 'class="mermaid"' not in html:
        return html
    return f'{html}\n<script src="{get_relative_url(MERMAID, page.url)}"></script>'


def executed_notebooks() -> list[Path]:
    """Pages of the notebooks that have been executed and have a picture."""
    return [path for path in sorted(NOTEBOOKS.glob("*.html")) if path.with_suffix(".png").is_file()]


def gallery(notebooks: Sequence[Path]) -> str:
    """A section with a picture of each executed notebook that leads to its page; empty: none has been executed."""
    entries = [f"[![{path.stem}](notebooks/{path.stem}.png)](notebooks/{path.name})" for path in notebooks]
    return "\n\n## Executed\n\n" + "\n\n".join(entries) + "\n" if entries else ""


def _linked(source: Path) -> list[Path]:
    """The files and folders of the repository that a file links to."""
    links = LINK.finditer(_content(source)) if _has_links(source) else ()
    return [path for link in links if (path := _target(source, link["path"]))]


def _has_links(source: Path) -> bool:
    return source.is_dir() or source.suffix == ".md"


def _target(source: Path, link: str) -> Path | None:
    """Target of a link in a file, if that is in the repository."""
    path = Path(os.path.normpath(source.parent / link))
    return path if path.exists() and path.is_relative_to(ROOT) else None


def _content(path: Path) -> str:
    """The Markdown of a page that shows a file or folder."""
    if path.suffix == ".md":
        return path.read_text(encoding="utf-8")
    head = f"---\nsearch:\n  exclude: true\n---\n\n# {path.relative_to(ROOT)}\n\n"
    if path.is_dir():
        files = [file for file in sorted(path.iterdir()) if not file.name.startswith((".", "__pycache__"))]
        return head + "".join(f"- [{file.name}]({path.name}/{file.name})\n" for file in files)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return f"{head}A file of {path.stat().st_size} bytes that is no text.\n"
    return f"{head}````{LANGUAGES.get(path.suffix, 'text')}\n{text}````\n"


def _site_name(path: Path) -> str:
    """Address of a file or folder of the repository in the site."""
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    name = f"{FOLDER}/{path.relative_to(ROOT).as_posix()}"
    return name if path.suffix == ".md" else f"{name}.md"


def _source(site_name: str) -> Path:
    """The file or folder of the repository that a page of the site shows."""
    folder, _, name = site_name.partition("/")
    if folder != FOLDER:
        return DOCS / site_name
    return ROOT / name if (ROOT / name).exists() else ROOT / name.removesuffix(".md")
