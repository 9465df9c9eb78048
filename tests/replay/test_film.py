"""Films: what their frames show, and the files that hold them."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image, ImageSequence

from tests.synthetic_run import write_run
from torch_iac.replay.film import SMALL, Film, writer_for
from torch_iac.replay.frames import HEIGHT, ROOM, ROOM_AT, WIDTH
from torch_iac.replay.scenes import Scene, Stage
from torch_iac.runs.reader import Run, load_run

WORLD = {"render_fps": 4, "sensor_units": ("m", "cm")}
CARD = 6  # frames, at four a second


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A made-up run, long enough for regions with several cuts."""
    return load_run(write_run(tmp_path_factory.mktemp("run"), n_decisions=1300))


def scene(run: Run, decision: int, stage: Stage | None = None, n_pictures: int = 2) -> Scene:
    """Return a decision and pictures of it in grey, each lighter than the one before."""
    row = run.table(agent=0).to_pylist()[decision]
    pictures = [np.full((ROOM[1], ROOM[0], 3), 10 + place, np.uint8) for place in range(n_pictures)]
    return Scene(stage or Stage("A stage", decision, 1), row, pictures)


def test_a_film_has_a_title_for_each_stage_and_every_picture_of_each_scene(run: Run) -> None:
    one, other = Stage("One", 3, 2), Stage("Other", 9, 1)
    scenes = [scene(run, 3, one, 3), scene(run, 4, one, 3), scene(run, 9, other, 1)]
    frames = list(Film(run, 0, WORLD).frames(scenes))
    left, top = ROOM_AT
    corners = [int(frame[top, left, 0]) for frame in frames]
    titles = [255] * CARD
    assert corners == [*titles, 10, 11, 12, 10, 11, 12, *titles, 10]
    assert {frame.shape for frame in frames} == {(HEIGHT, WIDTH, 3)}


def test_the_room_stays_in_its_place(run: Run) -> None:
    """A picture of another size is fitted in."""
    a_scene, (left, top), (_, height) = scene(run, 1200, n_pictures=1), ROOM_AT, ROOM
    *_, sheet = Film(run, 0, WORLD).frames([a_scene])
    narrow = replace(a_scene, pictures=[np.full((30, 20, 3), 200, np.uint8)])
    *_, shown = Film(run, 0, WORLD).frames([narrow])
    assert np.argwhere((shown != sheet).any(axis=2)).min(axis=0).tolist() == [top, left]
    assert (shown[top : top + height, left : left + height * 20 // 30] == 200).all()


def test_a_world_without_zones_can_be_filmed(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path, n_decisions=3, zone_names=None))
    assert len(list(Film(run, 0, WORLD).frames([scene(run, 2)]))) == CARD + 2


def test_a_video_holds_every_frame(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.mp4"
    Film(run, 0, WORLD).save([scene(run, 2)], path)
    assert count_frames_and_secs(path) == (CARD + 2, (CARD + 2) / 4)
    assert [file.name for file in path.parent.iterdir()] == ["a.mp4"]


def test_a_small_film_holds_what_moves(run: Run, tmp_path: Path) -> None:
    Film(run, 0, WORLD).save([scene(run, 2)], tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as film:
        assert film.size == SMALL
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
    assert durations == [1500, 250, 250]  # milliseconds: the title once, and two pictures


def test_a_film_that_breaks_off_leaves_nothing(run: Run, tmp_path: Path) -> None:
    def broken() -> Iterator[Scene]:
        yield scene(run, 2)
        raise ValueError("as before")

    for name in ("a.mp4", "a.gif"):
        with pytest.raises(ValueError, match="as before"):
            Film(run, 0, WORLD).save(broken(), tmp_path / name)
    assert not any(tmp_path.iterdir())


def test_a_film_is_a_video_or_a_gif() -> None:
    with pytest.raises(ValueError, match=r"a film must be a \.mp4 or a \.gif, got film\.avi"):
        writer_for(Path("film.avi"))


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ValueError, match=r"ffmpeg: pip install 'torch_iac\[video\]'"):
        writer_for(Path("film.mp4"))
    writer_for(Path("film.gif"))  # which needs none
