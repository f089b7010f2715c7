"""The picture of a room that ``python -m tools.look`` writes."""

from pathlib import Path

import cv2

from companion.kernel.errors import EXIT_FLOWN, EXIT_USAGE
from tools.look import VIEW_PX, main

ROOM = Path(__file__).parents[2] / "flightplans" / "rooms" / "corridor.toml"


def test_picture_and_mean_disparity_of_a_place(tmp_path, capsys):
    out = tmp_path / "view.png"

    assert main([str(ROOM), "--at", "-2", "0", "1.2", "30", "--out", str(out)]) == EXIT_FLOWN

    picture = cv2.imread(str(out), cv2.IMREAD_GRAYSCALE)
    assert picture.shape[0] == VIEW_PX
    assert picture.std() > 20
    assert "mean disparity" in capsys.readouterr().out


def test_unusable_room_is_one_line_on_stderr(tmp_path, capsys):
    assert main([str(tmp_path / "gone.toml"), "--out", "view.png"]) == EXIT_USAGE

    said = capsys.readouterr()
    assert "gone.toml: no such file" in said.err
    assert said.out == ""
