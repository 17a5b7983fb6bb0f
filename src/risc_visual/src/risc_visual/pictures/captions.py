"""The texts of a picture: names beside their objects, the rest in one panel at the edge. Needs no ROS and no rviz.

No text covers another or a vehicle. rviz cannot do this (its texts are points of the scene), so it draws none of them
and they are written here. Pixels: x right, y down, (0, 0) is the top left corner.
"""

import pathlib
import textwrap
from dataclasses import dataclass, field
from typing import NamedTuple

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

PANEL = 0.21  # of the picture's width
_EVEN_PX = 16  # the scene's width is a multiple of this, which suits rendering in software
_EM = 1.0 / 56.0  # height of letters / height of the picture
_EM_MIN_PX = 9
_SMALL = 0.8  # numbers on the floor and paragraphs / the other texts
_LINE = 0.25  # width of a line in the panel / its length
_RINGS = 12  # distances from its anchor at which room for a name is looked for
_DIRECTIONS = ((0, -1), (0, 1), (1, 0), (-1, 0), (1, -1), (-1, -1), (1, 1), (-1, 1))  # the first that has room


class Scheme(NamedTuple):
    """Colours of a picture, 0..255."""

    ground: tuple[int, int, int]
    panel: tuple[int, int, int]
    ink: tuple[int, int, int]
    floor: tuple[int, int, int]  # lines of the floor


DARK = Scheme((0, 0, 0), (24, 24, 24), (240, 240, 240), (136, 138, 133))
LIGHT = Scheme((255, 255, 255), (244, 244, 244), (20, 20, 20), (110, 110, 110))


class Name(NamedTuple):
    """A text that belongs to a place in the picture."""

    text: str
    anchor_px: tuple[float, float]
    reach_px: tuple[float, float]  # half width and half height of the named object around the anchor
    rgb: tuple[float, float, float]  # 0..1
    movable: bool = True  # False: stands at its anchor, or nowhere
    vehicle: bool = False  # nothing may be written over the named object


class Row(NamedTuple):
    """A line of the panel."""

    text: str
    rgb: tuple[float, float, float] | None = None  # 0..1; None: the scheme's ink
    mark: str = ""  # before the text: "dot" or "line"
    mark_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bold: bool = False
    small: bool = False
    space: bool = False  # some room above


class Box(NamedTuple):
    """A rectangle [px]."""

    left: float
    top: float
    right: float
    bottom: float

    def overlaps(self, other):
        """Whether the two have more than an edge in common."""
        return (
            self.left < other.right and other.left < self.right and self.top < other.bottom and other.top < self.bottom
        )


class Placed(NamedTuple):
    """A text, or a mark before one, and where it stands."""

    text: str  # of a mark "dot" or "line"
    box: Box
    rgb: tuple[int, int, int]
    em_px: int
    bold: bool = False
    anchor_px: tuple[float, float] | None = None  # a line leads there from a name that is far off


@dataclass
class Layout:
    """Where everything stands that is written into a picture."""

    size_px: tuple[int, int]
    scene_px: int  # width of the scene; the panel is right of it
    texts: list = field(default_factory=list)  # of Placed
    vehicles: list = field(default_factory=list)  # of Box, around each
    marks: list = field(default_factory=list)  # of Placed


def scene_size(size_px):
    """(width, height) [px] of the scene in a picture of this size."""
    width, height = size_px
    return round((1.0 - PANEL) * width / _EVEN_PX) * _EVEN_PX, height


def lay_out(names, rows, size_px, scheme):
    """Layout of names in the scene and rows in the panel; a name for which there is no room is left out."""
    scene = scene_size(size_px)
    em = max(_EM_MIN_PX, round(_EM * min(size_px[1], 0.75 * size_px[0])))
    found = Layout(size_px, scene[0])
    found.vehicles = [_around(name.anchor_px, name.reach_px) for name in names if name.vehicle]
    _place_names(found, names, em, Box(0, 0, *scene))
    _place_rows(found, rows, em, scheme)
    return found


def _place_names(found, names, em, scene):
    """Place names: first those that are not movable, then those of vehicles, then the rest."""
    for name in sorted(names, key=lambda name: (name.movable, not name.vehicle)):
        size = em if name.movable else round(_SMALL * em)
        taken = found.vehicles + [item.box for item in found.texts]
        for box in _candidates(name, *_extent(name.text, size)):
            inside = box.left >= 0 and box.top >= 0 and box.right <= scene.right and box.bottom <= scene.bottom
            if inside and not any(box.overlaps(other) for other in taken):
                anchor = name.anchor_px if name.movable else None
                found.texts.append(Placed(name.text, box, _ink(name.rgb), size, anchor_px=anchor))
                break


def _candidates(name, wide, high):
    """Boxes for a name, the best first."""
    if not np.isfinite(name.anchor_px).all():
        return
    if not name.movable:
        yield _around(name.anchor_px, (0.5 * wide, 0.5 * high))
        return
    for ring in range(_RINGS):
        away = np.array(name.reach_px) + 1 + 0.6 * high * ring + (0.5 * wide, 0.5 * high)
        for direction in _DIRECTIONS:
            yield _around(name.anchor_px + direction * away, (0.5 * wide, 0.5 * high))


def _place_rows(found, rows, em, scheme):
    """Place rows from the top of the panel downwards; long ones are wrapped, those without room left out."""
    width, height = found.size_px
    left, right, y = found.scene_px + em, width - 0.5 * em, 1.2 * em
    for row in rows:
        size = round(_SMALL * em) if row.small else em
        y += 0.8 * em if row.space else 0.0
        indent = 1.4 * size if row.mark else 0.0
        for number, line in enumerate(_wrapped(row.text, size, row.bold, right - left - indent)):
            wide, high = _extent(line, size, row.bold)
            box = Box(left + indent, y, left + indent + wide, y + high)
            if box.bottom > height:
                return
            if row.mark and number == 0:
                mark = _around((left + 0.4 * size, 0.5 * (box.top + box.bottom)), (0.4 * size, 0.4 * size))
                found.marks.append(Placed(row.mark, mark, _ink(row.mark_rgb), size))
            rgb = scheme.ink if row.rgb is None else _ink(row.rgb)
            found.texts.append(Placed(line, box, rgb, size, row.bold))
            y = box.bottom + 0.15 * size


def _wrapped(text, size, bold, room_px):
    """Lines of a text, at most room_px wide."""
    for paragraph in text.split("\n"):
        columns = len(paragraph)
        while columns > 8 and max(_extent(line, size, bold)[0] for line in textwrap.wrap(paragraph, columns)) > room_px:
            columns -= 1
        yield from textwrap.wrap(paragraph, max(8, columns)) or [""]


def write(picture, layout, scheme):
    """The picture (height, width, 3), uint8, RGB, of a scene with its layout; the panel is added."""
    width, height = layout.size_px
    canvas = Image.new("RGB", (width, height), scheme.panel)
    canvas.paste(Image.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(canvas)
    for item in layout.texts:
        if item.anchor_px is not None:  # a thin line from a name to what it names, when it is not beside it
            (x, y), box = item.anchor_px, item.box
            near = min(max(x, box.left), box.right), min(max(y, box.top), box.bottom)
            if np.hypot(near[0] - x, near[1] - y) > 4.0 * item.em_px:
                draw.line((*near, x, y), fill=item.rgb, width=1)
    for item in layout.marks:
        box, side = item.box, item.box.bottom - item.box.top
        middle = 0.5 * (box.left + box.right), 0.5 * (box.top + box.bottom)
        if item.text == "dot":
            draw.text(middle, "\N{BLACK CIRCLE}", fill=item.rgb, font=_font(round(1.3 * side)), anchor="mm")
        else:
            ends = (box.left, middle[1], box.right, middle[1])
            draw.line(ends, fill=item.rgb, width=max(2, round(_LINE * side)))
    for item in layout.texts:
        halo = _halo(item.em_px)
        around = {} if item.box.left >= layout.scene_px else {"stroke_width": halo, "stroke_fill": scheme.ground}
        place, font = (item.box.left + halo, item.box.top + halo), _font(item.em_px, item.bold)
        draw.text(place, item.text, fill=item.rgb, font=font, anchor="la", **around)
    return np.asarray(canvas)


def _around(centre, reach):
    (x, y), (wide, high) = centre, reach
    return Box(x - wide, y - high, x + wide, y + high)


def _ink(rgb):
    return tuple(round(255 * value) for value in rgb)


def _halo(size):
    return max(1, size // 8)


def _extent(text, size, bold=False):
    """(width, height) [px] of a line of text with its halo."""
    font = _font(size, bold)
    ascent, descent = font.getmetrics()
    return font.getlength(text) + 2 * _halo(size), ascent + descent + 2 * _halo(size)


def _font(size, bold=False):
    """matplotlib's own font, which is installed with matplotlib."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(pathlib.Path(matplotlib.get_data_path(), "fonts", "ttf", name)), size)
