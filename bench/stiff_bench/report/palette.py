"""The page's colours, light and dark, and which of them must be told apart."""

from __future__ import annotations

from collections.abc import Mapping

LEAST_CONTRAST = 4.5
"""Of text and its ground: WCAG 2.2, success criterion 1.4.3, level AA."""

LIGHT: Mapping[str, str] = {
    "ink": "#1c2430",
    "quiet": "#4f5b6b",
    "ground": "#ffffff",
    "raised": "#f2f5f9",
    "line": "#c3ccd8",
    "link": "#0b57a4",
    "better": "#d9ecff",
    "worse": "#ffe6d5",
}
DARK: Mapping[str, str] = {
    "ink": "#e8edf4",
    "quiet": "#b4c0cf",
    "ground": "#14181f",
    "raised": "#1f2630",
    "line": "#46525f",
    "link": "#8cc4ff",
    "better": "#123a5e",
    "worse": "#5a3016",
}
TEXT_ON: tuple[tuple[str, str], ...] = (
    *(("ink", ground) for ground in ("ground", "raised", "better", "worse")),
    *(("quiet", ground) for ground in ("ground", "raised")),
    *(("link", ground) for ground in ("ground", "raised")),
)
"""Text colour and ground, wherever one stands on the other."""


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours, 1..21, as WCAG 2 defines it.

    >>> contrast("#000000", "#ffffff")
    21.0
    """
    dark, light = sorted((_luminance(one), _luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def variables() -> str:
    """Return the colours as CSS variables; the dark ones where the reader's system is dark."""
    dark = "@media screen and (prefers-color-scheme: dark) "
    return f":root {{ {_declared(LIGHT)} }}\n{dark}{{ :root {{ {_declared(DARK)} }} }}\n"


def _declared(colours: Mapping[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


def _luminance(colour: str) -> float:
    channels = (int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5))
    red, green, blue = (
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
