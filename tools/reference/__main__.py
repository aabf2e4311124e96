"""Writes all pages of the reference again."""

from __future__ import annotations

from tools.reference.pages import PAGES

if __name__ == "__main__":
    for file, document in PAGES.items():
        file.write_text(document(), encoding="utf-8")
