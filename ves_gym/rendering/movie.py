"""The drawing process: frames of a run into a GIF, an MP4 or a window.

Started by `render` as `python -m ves_gym.rendering.movie JOB TARGET`, with MUJOCO_GL set.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ves_gym._util.params import Array
from ves_gym.rendering.drawing import FORCE, JOINT, MOMENT, PATH, TOOL, Drawing
from ves_gym.rendering.render import View
from ves_gym.system.system import System

_GAP = 2  # pixels between the two pictures
_TRAIL = 3.0  # s of the base's past path that is drawn

Clip = dict[str, Array]


def _modes(clip: Clip, k: int) -> Array | None:
    """Flexures and internal modes at frame k, None where there are none."""
    return clip["u"][k] if "u" in clip else None


def _half(view: View) -> int:
    """Width of one of the two pictures."""
    return (view.width - _GAP) // 2


def _decorate(
    scene: Any, drawing: Drawing, clip: Clip, view: View, k: int, extent: float
) -> None:
    """Add to frame k what is not a rigid body."""
    drawing.add_support(scene, clip["y"][k], extent, _modes(clip, k))
    if "p" in clip:
        drawing.add_payload(scene, clip["p"][k])
    first = max(0, k - round(_TRAIL * view.fps / view.speed))
    drawing.add_path(scene, clip["y"][first : k + 1], extent)
    if "w" in clip:
        force, moment = np.linalg.norm(clip["w"].reshape(-1, 2, 3), axis=2).max(axis=0)
        drawing.add_wrench(scene, clip["y"][k], clip["w"][k], (force, moment))


def _frames(drawing: Drawing, clip: Clip, view: View) -> Iterator[Array]:
    """Finished pictures (height, width, 3) uint8, reported on stdout one by one."""
    from PIL import Image, ImageDraw, ImageFont

    half = _half(view)
    cameras = drawing.cameras(clip["y"], clip["q"], half / view.height)
    font = ImageFont.load_default(max(10, view.height // 28))
    count, margin = len(clip["t"]), view.height // 40
    legend = [("base path", PATH)]
    if "w" in clip:
        legend += [("force on base", FORCE), ("moment", MOMENT)]
    with mujoco.Renderer(drawing.model, view.height, half, max_geom=2000) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        for k in range(count):
            drawing.pose(clip["y"][k], clip["q"][k], _modes(clip, k))
            page = np.full((view.height, view.width, 3), 60, np.uint8)
            for side, (camera, extent) in enumerate(cameras):
                renderer.update_scene(drawing.data, camera)
                _decorate(renderer.scene, drawing, clip, view, k, extent)
                offset = side * (view.width - half)
                page[:, offset : offset + half] = renderer.render()
            image = Image.fromarray(page)
            text = f"t = {clip['t'][k]:5.2f} s    base energy {clip['E'][k]:.3g} J"
            if view.magnify != 1:
                text += f"    base motion x {view.magnify:g}"
            pen = ImageDraw.Draw(image)
            pen.text((margin, margin), text, (225, 230, 240), font)
            at = margin
            for word, rgba in legend:
                colour = tuple(round(255 * c) for c in rgba[:3])
                pen.text((at, view.height - margin), word, colour, font, anchor="ls")
                at += round(font.getlength(word)) + 2 * margin
            print((k + 1) / count, flush=True)
            yield np.asarray(image)


def _write_gif(path: Path, frames: Iterator[Array], fps: float) -> None:
    from PIL import Image

    first = Image.fromarray(next(frames))
    # one palette for all, so that nothing flickers; with the colours that come later
    shades = np.linspace(0.25, 1.0, 16)[:, None, None]
    accents = np.array([c[:3] for c in (FORCE, MOMENT, PATH, TOOL, JOINT)])
    swatch = Image.fromarray((255 * shades * accents).round().astype(np.uint8))
    sample = first.copy()
    sample.paste(swatch.resize((first.width, first.height // 4), Image.Resampling.NEAREST))
    palette = sample.quantize(256, Image.Quantize.MEDIANCUT)

    def reduced(image: Image.Image) -> Image.Image:
        return image.quantize(palette=palette, dither=Image.Dither.NONE)

    reduced(first).save(
        path,
        save_all=True,
        append_images=(reduced(Image.fromarray(f)) for f in frames),
        duration=round(1000 / fps),
        loop=0,
    )


def _write_mp4(path: Path, frames: Iterator[Array], view: View) -> None:
    import imageio_ffmpeg

    size = (view.width, view.height)
    writer = imageio_ffmpeg.write_frames(str(path), size, fps=view.fps, macro_block_size=2)
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def _window(drawing: Drawing, clip: Clip, view: View) -> None:
    from mujoco.viewer import launch_passive

    with launch_passive(
        drawing.model, drawing.data, show_left_ui=False, show_right_ui=False
    ) as viewer:
        camera, extent = drawing.cameras(clip["y"], clip["q"], 4 / 3)[0]
        viewer.cam.lookat[:], viewer.cam.distance = camera.lookat, camera.distance
        viewer.cam.azimuth, viewer.cam.elevation = camera.azimuth, camera.elevation
        k, due = 0, time.monotonic()
        while viewer.is_running():
            with viewer.lock():
                drawing.pose(clip["y"][k], clip["q"][k], _modes(clip, k))
                viewer.user_scn.ngeom = 0
                _decorate(viewer.user_scn, drawing, clip, view, k, extent)
            viewer.sync()
            k = (k + 1) % len(clip["t"])
            due = max(due + 1 / view.fps, time.monotonic() - 1.0)
            time.sleep(max(0.0, due - time.monotonic()))


def _main(job: str, target: str) -> None:
    with np.load(job) as arrays:
        clip = {k: arrays[k] for k in arrays.files if k != "job"}
        plain = json.loads(str(arrays["job"]))
    view = View(**plain["view"])
    drawing = Drawing(System.from_dict(plain["system"]), _half(view), view.height)
    path = Path(target)
    if path.suffix == ".gif":
        _write_gif(path, _frames(drawing, clip, view), view.fps)
    elif path.suffix == ".mp4":
        _write_mp4(path, _frames(drawing, clip, view), view)
    else:
        _window(drawing, clip, view)


if __name__ == "__main__":
    _main(*sys.argv[1:])
