"""Makes a film of scenes of a run: the world's pictures with annotation panels.

Frames have shape `(720, 1280, 3)`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from torch_iac.internal.files import replace
from torch_iac.replay.frames import HEIGHT, ROOM, ROOM_AT, WIDTH, Frame, Sheets
from torch_iac.replay.scenes import Scene
from torch_iac.runs.reader import Run

CARD_SECONDS = 1.5
"""How long (s) the title of a stage is shown."""

SMALL = (800, 450)
"""Width and height of a film for web pages (pixels)."""

N_COLOURS = 128
"""How many colours a film for web pages has."""

N_FOR_COLOURS = 60
"""The palette is made from the first frames, this many."""


@dataclass(frozen=True)
class Film:
    """A film of one robot of a run.

    Attributes:
        run: The run.
        agent: Which robot.
        world: The world's metadata: its `render_fps` pictures are a second of the film,
            its sensors have `sensor_units`.
    """

    run: Run
    agent: int = 0
    world: Mapping[str, Any] = field(default_factory=dict)

    def frames(self, scenes: Iterable[Scene]) -> Iterator[Frame]:
        """Return what the film shows: a title for each stage, and every picture of each scene.

        Each frame has shape `(720, 1280, 3)`.
        """
        sheets, stage = Sheets(self.run, self.agent, self.world), None
        for scene in scenes:
            if scene.stage != stage:
                stage = scene.stage
                yield from [sheets.card(stage)] * round(CARD_SECONDS * self.pictures_a_second)
            sheet = sheets.sheet(scene.row, stage)
            for picture in scene.pictures:
                yield _with_picture(sheet, picture)

    def save(self, scenes: Iterable[Scene], path: Path) -> None:
        """Write the film: `.mp4`, or `.gif` for a small one for web pages.

        Raises:
            ValueError: The file's name ends otherwise, or the library for `.mp4` is missing.
        """
        write = writer_for(path)
        frames = self.frames(scenes)
        path.parent.mkdir(parents=True, exist_ok=True)
        replace(path, lambda temporary: write(temporary, frames, self.pictures_a_second))

    @property
    def pictures_a_second(self) -> int:
        """How many pictures of the world are a second of the film."""
        return int(self.world.get("render_fps", 2))


Writer = Callable[[Path, Iterable[Frame], int], None]
"""Writes a film: where, its frames, and how many of them are a second."""


def writer_for(path: Path) -> Writer:
    """Return what writes a film of that name.

    Raises:
        ValueError: The name ends otherwise than in `.mp4` or `.gif`, or the library is missing.
    """
    if path.suffix == ".gif":
        return _write_gif
    if path.suffix != ".mp4":
        raise ValueError(f"a film must be a .mp4 or a .gif, got {path}")
    try:
        import imageio_ffmpeg  # noqa: F401
    except ImportError:
        raise ValueError("a .mp4 needs ffmpeg: pip install 'torch_iac[video]'") from None
    return _write_mp4


def _write_mp4(path: Path, frames: Iterable[Frame], pictures_a_second: int) -> None:
    from imageio_ffmpeg import write_frames

    as_mp4 = ["-f", "mp4", "-movflags", "+faststart"]  # whatever the name's suffix
    writer = write_frames(
        path,
        (WIDTH, HEIGHT),
        fps=pictures_a_second,
        codec="libx264",
        ffmpeg_log_level="error",
        output_params=as_mp4,
    )
    with closing(writer):
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))


def _write_gif(path: Path, frames: Iterable[Frame], pictures_a_second: int) -> None:
    small = (Image.fromarray(frame).resize(SMALL, Image.Resampling.LANCZOS) for frame in frames)
    begin = list(islice(small, N_FOR_COLOURS))
    palette = _palette(begin)
    few = (_with_colours(palette, image) for image in chain(begin, small))
    first = next(few)
    first.save(
        path,
        "GIF",
        save_all=True,
        append_images=few,
        duration=1000 // pictures_a_second,
        loop=0,
    )


def _palette(images: Sequence[Image.Image]) -> Image.Image:
    """Return an image that has the colours for all frames, so that nothing flickers."""
    some = np.concatenate([np.asarray(image) for image in images[::10]])
    return Image.fromarray(some).quantize(N_COLOURS, Image.Quantize.FASTOCTREE)


def _with_colours(palette: Image.Image, image: Image.Image) -> Image.Image:
    return image.quantize(palette=palette, dither=Image.Dither.NONE)


def _with_picture(sheet: Frame, picture: Frame) -> Frame:
    frame = sheet.copy()
    left, top = ROOM_AT
    fitted = ImageOps.contain(Image.fromarray(picture), ROOM)
    frame[top : top + fitted.height, left : left + fitted.width] = np.asarray(fitted)
    return frame
