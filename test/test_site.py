"""The documentation site: it builds without a warning, needs no other host, and has all pages and pictures."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
TEXTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
NOT_ON_A_PAGE = [DOCS / "logo.svg", *DOCS.glob("badges/*")]
"""The logo is on every page of the site, and badges are in the README."""
PICTURES = sorted(
    path for path in DOCS.rglob("*") if path.suffix in {".png", ".svg", ".jpg", ".gif"} and path not in NOT_ON_A_PAGE
)

COMMAND = re.compile(r"`(?:make|sal-height|\S+/python|tools/\w+\.py) [^`]+`")
"""A command of the repository in a caption."""

MAKES_PICTURES = re.compile(r"^\S+/python .*\bpicture of this page", re.MULTILINE)
"""A line of a text block that says so of a command."""


class Page(HTMLParser):
    """What a page of the site loads, where it leads, and its anchors."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if "src" in values:
            self.loaded.append(values["src"])
        if tag == "link" and values.get("rel") not in {"canonical", "next", "prev"}:
            self.loaded.append(values["href"])
        if tag == "a" and "href" in values:
            self.links.append(values["href"])


def test_no_page_is_longer_than_a_sitting() -> None:
    """Pages that are written by hand have 1,200 words at most; parameters.md is a table."""
    lengths = {page.stem: len(page.read_text(encoding="utf-8").split()) for page in DOCS.glob("*.md")}
    assert {name: words for name, words in lengths.items() if words > 1200 and name != "parameters"} == {}


def test_every_package_with_a_face_has_a_page_of_the_python_reference() -> None:
    pages = {path.stem for path in (DOCS / "python").glob("*.md")}
    core = {path.parent.name for path in (ROOT / "sal_height").glob("*/__init__.py") if "__all__" in path.read_text()}
    assert pages == core - {"bag", "commands", "messages", "numeric"}


def test_executed_notebooks_are_a_gallery(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One without a picture is left out, and there is no section where none has been executed."""
    pytest.importorskip("mermaidx", reason="the tools of the site are not installed: pip install '.[docs]'")
    monkeypatch.syspath_prepend(ROOT / "tools")
    import site_hooks

    monkeypatch.setattr(site_hooks, "NOTEBOOKS", tmp_path)
    assert site_hooks.gallery(site_hooks.executed_notebooks()) == ""
    for name in ("one.html", "one.png", "other.html"):
        (tmp_path / name).touch()
    shown = site_hooks.gallery(site_hooks.executed_notebooks())
    assert re.findall(r"\(([^)]+)\)", shown) == ["notebooks/one.png", "notebooks/one.html"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, built with warnings as errors."""
    pytest.importorskip("material", reason="mkdocs-material is not installed: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)  # noqa: S603
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}


def test_nothing_is_loaded_from_another_host(site: Path, pages: dict[Path, Page]) -> None:
    loaded = {url for page in pages.values() for url in page.loaded}
    for styled in (*site.rglob("*.css"), *site.rglob("*.svg")):
        loaded |= set(re.findall(r"url\(\s*[\"']?([^\"')]+)", styled.read_text(encoding="utf-8")))
    assert len(loaded) > 10
    assert [url for url in loaded if urlsplit(url).netloc] == []


def test_every_link_leads_to_a_page_and_an_anchor(pages: dict[Path, Page], site: Path) -> None:
    for path, page in pages.items():
        if path.name == "404.html":  # its links begin at the root of the host
            continue
        for link in (*page.links, *page.loaded):
            url = urlsplit(link)
            if url.scheme in {"http", "https", "data"}:
                continue
            target = (path.parent / unquote(url.path)).resolve() if url.path else path
            target = target / "index.html" if target.is_dir() else target
            assert target.is_file(), f"{link} in {path.relative_to(site)}"
            assert not url.fragment or unquote(url.fragment) in pages[target].anchors | {"__skip"}, f"{link} in {path}"


def test_files_of_the_repository_are_pages(site: Path, pages: dict[Path, Page]) -> None:
    assert "repository/msg_defs/msg/SensorInfo.msg.html" in pages[site / "live_air.html"].links
    text = (site / "repository" / "msg_defs" / "msg" / "SensorInfo.msg.html").read_text(encoding="utf-8")
    assert "CONTRACT_VERSION" in text
    assert "../live.html" in pages[site / "repository" / "index.html"].links
    assert {"index.html", "CONTRIBUTING.html", "CHANGELOG.html"} <= {p.name for p in (site / "repository").iterdir()}


def test_diagrams_are_drawn_by_a_script_of_the_site(site: Path, pages: dict[Path, Page]) -> None:
    with_diagram = [path for path in pages if 'class="mermaid"' in path.read_text(encoding="utf-8")]
    assert site / "repository" / "index.html" in with_diagram
    for path in with_diagram:
        (script,) = (name for name in pages[path].loaded if "mermaid" in name)
        assert "flowchart" in (path.parent / script).read_text(encoding="utf-8")


def test_every_page_is_in_the_navigation_once() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    listed = [name for name in re.findall(r": (\S+\.md)$", navigation, re.MULTILINE) if "repository/" not in name]
    assert sorted(listed) == sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))


@pytest.mark.parametrize("text", TEXTS, ids=lambda path: path.name)
def test_lists_are_read_alike_by_code_forges_and_the_site(text: Path) -> None:
    """A further paragraph of an item is indented by four spaces, and a list follows an empty line."""
    prose = re.sub(r"^```.*?^```$", "```", text.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert re.findall(r"\n\n {1,3}[^ \n].*", prose) == []
    assert re.findall(r"\n[^\s\-*+|].*\n[\-*+] .*", re.sub(r"\n +", " ", prose)) == []


@pytest.mark.parametrize("picture", PICTURES, ids=lambda path: path.name)
def test_a_picture_is_used_and_says_what_made_it(picture: Path) -> None:
    texts = [text for text in TEXTS if captions_in(text, picture)]
    assert texts, "no text has it"
    captions = [caption for text in texts for caption in captions_in(text, picture)]
    commands = [text for text in texts if MAKES_PICTURES.search(text.read_text(encoding="utf-8"))]
    assert commands or any(COMMAND.search(caption) for caption in captions), captions


def captions_in(text: Path, picture: Path) -> list[str]:
    """The paragraphs of a text that show a picture or lead to it, each with the next one."""
    paragraphs = text.read_text(encoding="utf-8").split("\n\n")
    return [
        f"{paragraph}\n\n{following}"
        for paragraph, following in zip(paragraphs, [*paragraphs[1:], ""], strict=True)
        if any((text.parent / link).resolve() == picture for link in re.findall(r"\]\(([^)#]+)\)", paragraph))
    ]
