"""HTML that needs nothing from outside: text, tables, and figures as data."""

import base64
from collections.abc import Iterable, Sequence
from html import escape
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

DPI = 110
_HEAD = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 72rem; margin: 0 auto;
 padding: 1rem 1.5rem 4rem; }}
h1 {{ font-size: 1.5rem; }}
h2 {{ font-size: 1.15rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid #ddd; }}
nav a {{ margin-right: 1em; white-space: nowrap; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: .15rem .8rem .15rem 0; text-align: left; vertical-align: top; }}
th {{ font-weight: 600; border-bottom: 1px solid #bbb; }}
td + td, th + th {{ text-align: right; padding-left: .8rem; }}
table.words td, table.words th {{ text-align: left; }}
img {{ max-width: 100%; height: auto; }}
.flown, .sound {{ color: #00694e; }} .failed, .aborted, .problem {{ color: #b04800; }}
.quiet {{ color: #777; }}
div.wide {{ overflow-x: auto; }}
</style>
</head>
<body>
"""


class Page:
    """Collects sections; figures also go as PNG and SVG into a folder, when one is given."""

    def __init__(self, title: str, figures: Path | None = None) -> None:
        self.title = title
        self._figures = figures
        self._sections: list[tuple[str, str]] = []

    def add(self, title: str, *parts: str) -> None:
        self._sections.append((title, "\n".join(parts)))

    def figure(self, figure: Figure, name: str) -> str:
        """An ``img`` that holds the figure as PNG; same figure, same bytes."""
        data = _saved(figure, "png")
        if self._figures is not None:
            self._figures.mkdir(parents=True, exist_ok=True)
            (self._figures / f"{name}.png").write_bytes(data)
            figure.set_layout_engine("none")  # it is laid out: no need to do it twice
            (self._figures / f"{name}.svg").write_bytes(_saved(figure, "svg"))
        text = base64.b64encode(data).decode("ascii")
        return f'<img alt="{escape(name)}" src="data:image/png;base64,{text}">'

    def html(self) -> str:
        links = [
            f'<a href="#s{number}">{escape(title)}</a>'
            for number, (title, _) in enumerate(self._sections)
        ]
        bodies = [
            f'<section id="s{number}">\n<h2>{escape(title)}</h2>\n{body}\n</section>'
            for number, (title, body) in enumerate(self._sections)
        ]
        title = escape(self.title)
        head = _HEAD.format(title=title)
        nav = f"<nav>{' '.join(links)}</nav>"
        return "\n".join([f"{head}<h1>{title}</h1>", nav, *bodies, "</body>\n</html>\n"])


def paragraph(text: str, kind: str = "") -> str:
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], words: bool = False) -> str:
    """Figures stand to the right, or, of ``words``, all to the left."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    lines = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    body = "\n".join(f"<tr>{line}</tr>" for line in lines)
    kind = ' class="words"' if words else ""
    top = f"<thead><tr>{head}</tr></thead>" if any(header) else ""
    return f'<div class="wide"><table{kind}>{top}\n<tbody>\n{body}\n</tbody></table></div>'


def folded(title: str, body: str) -> str:
    return f"<details><summary>{escape(title)}</summary>\n{body}\n</details>"


def _saved(figure: Figure, form: str) -> bytes:
    file = BytesIO()
    with mpl.rc_context({"svg.hashsalt": "report"}):
        metadata = {"Date": None} if form == "svg" else None
        figure.savefig(file, format=form, dpi=DPI, metadata=metadata)
    return file.getvalue()
