"""Badges of the README, as SVG: `python -m tools.badges` writes them anew from setup.py and the workflow of tests."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "badges"

BADGE = """\
<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="{label}: {value}">
  <rect width="{width}" height="20" rx="3" fill="#555"/>
  <path d="M{middle} 0h{inner}a3 3 0 0 1 3 3v14a3 3 0 0 1 -3 3h-{inner}z" fill="{colour}"/>
  <g fill="#fff" text-anchor="middle" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
    <text x="{left}" y="14">{label}</text>
    <text x="{right}" y="14">{value}</text>
  </g>
</svg>
"""


def badge(label: str, value: str, colour: str) -> str:
    """A badge as SVG."""
    letter, margin = 7, 12  # pixels of a letter, and of what is beside a text
    middle, width = letter * len(label) + margin, letter * (len(label) + len(value)) + 2 * margin
    return BADGE.format(
        label=label,
        value=value,
        colour=colour,
        width=width,
        middle=middle,
        inner=width - middle - 3,
        left=middle / 2,
        right=(middle + width) / 2,
    )


def badges() -> dict[Path, str]:
    """All badges by their files, from what setup.py, package.xml and the workflow of tests say."""
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    workflow = (ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
    (licence,) = re.findall(r'license="([^"]+)"', setup)
    (minors,) = re.findall(r"minor in \(([\d, ]+)\)", setup)
    tested = [f"3.{minor}" for minor in minors.split(", ") if f"3.{minor}" in workflow]
    found = {
        "tests": badge("tests", "make test", "#0072b2"),
        "python": badge("Python", " | ".join(tested), "#0072b2"),
        "ros": badge("ROS 2", "Jazzy", "#0072b2"),
        "licence": badge("licence", licence, "#009e73"),
        "docs": badge("docs", "make docs", "#009e73"),
    }
    return {FOLDER / f"{name}.svg": text for name, text in found.items()}


def main() -> None:
    """Write all badges."""
    FOLDER.mkdir(exist_ok=True)
    for path, text in badges().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
