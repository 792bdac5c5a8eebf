"""Draw every figure of `bench list figures` for the gallery: `python docs/gallery.py`.

Writes the pictures to docs/assets/gallery and the page docs/gallery.md. The figures of networks
show `results/paper/runs`; the fits behind the others take some minutes. With names, only those
figures are drawn: `python docs/gallery.py robot springs`.
"""

from __future__ import annotations

import functools
import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

import stiffbench as sb
from stiff_bench.figures.prepared_figure import Prepared

TOP = Path(__file__).parents[1]
PICTURES = TOP / "docs/assets/gallery"
PAPER_RUNS = TOP / "results/paper/runs"
WIDTH, COLOURS = 1100, 48
"""Pixels and palette of a picture: readable, and about 40 kB."""
PAGE_START = """# Gallery

Every figure of `bench list figures`, drawn by `python docs/gallery.py`. From your own results:

```sh
bench figure scores --results results/runs --output scores.png
```

More pictures: [tool path](correct-a-path.md), [stiffness map and posture](place-the-work.md),
[board](read-the-results.md).
"""
COMPARED = ("vjm", "vjm-full", "vjm-multisegment", "vjm-gp", "bayes-springs")
OF_COMPARED = ("scores", "regression", "errors", "workspace", "springs")
CURVES = ("vjm", "vjm-gp", "bayes-springs")
COVERAGES = (0.5, 0.7, 0.9)


def main(names: list[str]) -> None:
    """Draw the named figures, or all of them, and write the page."""
    figures = sb.list_figures().frame().set_index("name")["what it shows"]
    PICTURES.mkdir(exist_ok=True)
    for name in names or figures.index:
        save_small(prepare(name), PICTURES / f"{name}.png")
    (TOP / "docs/gallery.md").write_text(page_text(dict(figures)), encoding="utf-8")


def prepare(name: str) -> Prepared:
    """Gather the numbers of one figure."""
    if name == "4":  # fitted when it is drawn
        return sb.figure(name)
    if name in OF_COMPARED:
        return sb.figure(name, compared_models())
    if name == "what-bends":
        return sb.figure(name, sb.evaluate(["bayes-springs"], "arm-family@robot=8", splits=3))
    if name == "robot":
        return sb.figure(name, sb.load_dataset("kr10-twin"))
    if name == "learning-curves":
        robots = ["kr10-twin", "ur5-twin", "arm-family"]
        return sb.figure(name, sb.evaluate(CURVES, robots, protocol="sample-efficiency", splits=2))
    if name == "calibration":
        with tempfile.TemporaryDirectory() as folder:
            for coverage in COVERAGES:
                sb.evaluate(
                    ["vjm", "bayes-springs"],
                    "kr10-twin",
                    splits=3,
                    metrics=["coverage"],
                    coverage=coverage,
                    output=folder,
                )
            return sb.figure(name, folder)
    return sb.figure(name, PAPER_RUNS)


@functools.cache
def compared_models() -> sb.Results:
    """Fit the README's models to the simulated KR10."""
    return sb.evaluate(COMPARED, "kr10-twin", splits=5)


def save_small(prepared: Prepared, path: Path) -> None:
    """Save a figure with at most `WIDTH` pixels across and `COLOURS` colours."""
    full = io.BytesIO(prepared.picture(".png"))
    picture = Image.open(full).convert("RGB")
    if picture.width > WIDTH:
        height = round(picture.height * WIDTH / picture.width)
        picture = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
    picture.quantize(COLOURS).save(path, optimize=True)


def page_text(figures: dict[str, str]) -> str:
    """Return the gallery in Markdown: one heading, summary and picture per figure."""
    parts = [PAGE_START]
    for name, summary in figures.items():
        title = f"Figure {name} of the paper" if name.isdecimal() else name
        text = (summary[0].upper() + summary[1:]).replace("the VJM", "the [VJM](glossary.md)")
        parts.append(f"## {title}\n\n{text}.\n\n![{name}](assets/gallery/{name}.png)\n")
    return "\n".join(parts)


if __name__ == "__main__":
    main(sys.argv[1:])
