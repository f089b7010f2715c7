"""How far a tool has come is told on a terminal, and nowhere else."""

from io import StringIO

from rich.console import Console

from tools.progress import watched


def test_on_a_terminal_the_bar_ends_full():
    out = StringIO()
    console = Console(file=out, force_terminal=True, width=100)
    assert list(watched([3, 1, 2], "flights read", console)) == [3, 1, 2]
    assert "3/3 flights read" in out.getvalue()


def test_elsewhere_nothing_is_said():
    out = StringIO()
    assert list(watched("abc", "letters", Console(file=out))) == ["a", "b", "c"]
    assert out.getvalue().strip() == ""
