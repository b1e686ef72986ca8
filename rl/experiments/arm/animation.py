"""Learned behaviour in motion: a GIF with a panel for each condition, all from the same starts."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cpgrl_opt.arrays import UInt8
from envs import TwoLinkArm
from envs.arm_drawing import draw_objects, draw_reach, frame, joints

from ..figure_style import BLACK, blank_figure, panel_letter
from .paths import ArmPath

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH, _HEIGHT, _DPI = 2.5, 2.1, 120  # inches of a panel, pixels per inch
_FRAMES = 45  # of an episode at most; longer ones are shown in longer strides
_PAUSE = 1200  # ms at an episode's end
_COLOURS = 256

Frame = UInt8[np.ndarray, "height width 3"]


def write_animation(
    arm: TwoLinkArm, paths: Mapping[str, Sequence[ArmPath]], titles: Mapping[str, str], path: Path
) -> None:
    """Episode after episode of each condition's, side by side; one step is shown for `arm.dt`, as it would last.

    Parameters
    ----------
    arm
        What moves.
    paths
        Of each condition, as many episodes.
    titles
        Of the panels, by condition.
    path
        The GIF to write.
    """
    from PIL import Image

    stage = _Stage(arm, titles)
    images: list[Image.Image] = []
    durations: list[int] = []
    for episode in zip(*paths.values(), strict=True):
        for picture in stage.play(episode):
            image = Image.fromarray(picture)
            images.append(image.quantize(_COLOURS, palette=images[0] if images else None, dither=Image.Dither.NONE))
            durations.append(round(1000 * arm.dt))
        durations[-1] = _PAUSE
    first, *others = images
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0, optimize=True)


class _Stage:
    """Everything that stands still, drawn once; `play` draws what moves over it."""

    def __init__(self, arm: TwoLinkArm, titles: Mapping[str, str]) -> None:
        self.arm = arm
        figure = blank_figure(_WIDTH * len(titles), _HEIGHT)
        figure.set_dpi(_DPI)
        panels = figure.subplots(1, len(titles), squeeze=False)[0]
        figure.subplots_adjust(left=0.01, right=0.99, top=0.88, bottom=0.01, wspace=0.02)
        for axes, (name, title) in zip(panels, titles.items(), strict=True):
            draw_reach(axes, arm)
            draw_objects(axes, arm, scale=0.85)
            frame(axes, arm)
            axes.set_axis_off()
            panel_letter(axes, name.replace("-", r"\text{-}"), title)
        self.canvas = cast(Any, figure.canvas)
        self.canvas.draw()
        self.still = self.canvas.copy_from_bbox(figure.bbox)
        self.actors = [_Actor(axes, arm) for axes in panels]

    def play(self, episode: Sequence[ArmPath]) -> Iterator[Frame]:
        """All panels' paths together; the shorter ones wait at their end."""
        moments = [_moments(len(path.angles)) for path in episode]
        for k in range(max(map(len, moments))):
            self.canvas.restore_region(self.still)
            for actor, path, own in zip(self.actors, episode, moments, strict=True):
                actor.draw(path, own[min(k, len(own) - 1)])
            yield np.asarray(self.canvas.buffer_rgba())[:, :, :3].copy()


class _Actor:
    """What moves in one panel: the arm, the way of its end effector, a word on where it is."""

    def __init__(self, axes: "Axes", arm: TwoLinkArm) -> None:
        self.axes, self.arm = axes, arm
        (self.way,) = axes.plot([], [], color=BLACK, lw=0.7, zorder=6)
        (self.links,) = axes.plot([], [], "-", color="0.25", lw=2.6, solid_joinstyle="round", zorder=7)
        (self.ends,) = axes.plot([], [], "o", color=BLACK, ms=4, zorder=8)
        self.words = axes.text(0.98, 0.02, "", transform=axes.transAxes, ha="right", va="bottom", fontsize=8)

    def draw(self, path: ArmPath, moment: int) -> None:
        points = joints(self.arm, path.angles[moment])
        self.way.set_data(*self.arm.forward_kinematics(path.angles[: moment + 1]).T)
        self.links.set_data(*points.T)
        self.ends.set_data(*points[[0, 2]].T)
        ended = moment == len(path.angles) - 1
        end = path.touched if path.touched != "none" else "no touch"
        self.words.set_text(f"{end}, {moment} steps" if ended else f"step {moment}")
        for artist in (self.way, self.links, self.ends, self.words):
            self.axes.draw_artist(artist)


def _moments(length: int) -> list[int]:
    return [int(k) for k in np.linspace(0, length - 1, min(length, _FRAMES)).round()]
