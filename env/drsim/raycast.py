"""The camera's inner loops: sky and walls, then the ground, ray by ray.

The reference simulator renders 640 x 480 and shrinks the frame to 160 x 120 with a tent filter, two
output pixels wide. Each pixel of ours therefore is an average over its own tent: sideways by the
choice of the copy of the ground picture, downwards by several sample lines between two pixel rows.

A frame is made in layers, back to front: sky and walls, the ground, then the cuboids that stand on
it (boxes, other cars), the furthest first. All loops that call each other stay in this one file,
because numba's cache of a compiled loop does not notice that a loop of another file has changed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drsim.jit import kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Words = NDArray[np.uint32]
Pixels = NDArray[np.uint8]
Single = np.float32
Vector = tuple[float, float, float]

_SHARPNESS = 1.0
"""Side of a texel over that of a pixel on the ground, sideways. At 0.82 the blend of four texels
has the variance of the tent filter; 1.0 looks the same and reads less memory."""

_LINE_GAP = 2.2
"""Distance between sample lines, in texels. A gap of 1.6 takes 30 % longer and brings a frame from
0.7 to 0.6 greys of mean difference to one drawn with 144 rays in each pixel."""

_MOST_LINES = 2
"""Most sample lines between two pixel rows; near the horizon coarser texels take over."""

_EDGE_BLUR = 1.4
"""Width over which edges of walls fade, in pixels: such a box has the tent filter's variance."""

_LEAST_FALL = 0.004
"""Least fall of a ray per unit of depth: from 33 m away, all ground looks as it does there."""

_FURTHEST = 1e9
"""Limit of coordinates in 256ths of a texel: they must fit 32 bits however far a car is thrown."""


_SUN = (0.4846, -0.0969, 0.8693)
"""Direction to the sun. Source: the reference simulator's worlds, 121 of which share one sun."""

_NO_PALETTE = np.empty(0, np.uint8)

_NEAR_M = 0.02
"""Nothing nearer to the lens is drawn. Source: the reference simulator's camera."""

_LINES_PER_PIXEL = 3
"""Lines across a pixel row at which the outline of a cuboid is taken."""


@kernel
def draw(
    texels: Words,
    levels: Ints,
    grid: Floats,
    walls_m: Singles,
    wall_height_m: float,
    wall_greys: Singles,
    sky_greys: Singles,
    palettes: Pixels,
    boxes: Singles,
    box_light: Singles,
    focal_px: float,
    bias: float,
    lens_pos: Floats,
    lens_mat: Floats,
    out: Pixels,
) -> None:
    """Draw one frame for each lens; arguments as in `Scene`, `CameraModel` and `camera.render`.

    `grid` holds the corner of the ground picture, x and y, and the side of its texels, in metres.
    `wall_greys` and `sky_greys` have one row for all lenses or one for each, `palettes` none or one
    for each: the greys that the greys of the ground picture become. `bias` is added to a grey
    before its fraction is cut off.
    """
    cars, rows, columns = out.shape
    behind = np.empty((rows, columns), np.float32)
    share = np.empty((rows, columns), np.float32)
    for car in range(cars):
        pos, mat, frame = lens_pos[car], lens_mat[car], out[car]
        if not math.isfinite(pos.sum() + mat.sum()):
            frame[:] = 0
            continue
        first, clear = _backdrop(
            walls_m,
            wall_height_m,
            wall_greys[car % len(wall_greys)],
            sky_greys[car % len(sky_greys)],
            focal_px,
            pos,
            mat,
            behind,
            share,
        )
        for row in range(first):
            _store(behind[row], bias, frame[row])
        if first < rows:
            palette = palettes[car] if len(palettes) > 0 else _NO_PALETTE
            _floor(
                texels,
                levels,
                grid,
                palette,
                focal_px,
                bias,
                pos,
                mat,
                behind,
                share,
                first,
                clear,
                frame,
            )
        if boxes.shape[1] > 0:
            _cuboids(boxes[car], box_light[car], focal_px, bias, pos, mat, behind, share, frame)


@kernel
def _backdrop(
    walls_m: Singles,
    wall_height_m: float,
    wall_greys: Singles,
    sky_grey: float,
    focal_px: float,
    pos: Floats,
    mat: Floats,
    behind: Singles,
    share: Singles,
) -> tuple[int, int]:
    """Find the grey of walls and sky, and the share of the ground, in each pixel above the floor.

    Returns:
        The first row that shows any ground, and the first one that shows nothing else. Rows from
        the second on are not filled.
    """
    rows, columns = behind.shape
    inside = walls_m[0] < pos[0] < walls_m[1] and walls_m[2] < pos[1] < walls_m[3]
    upright = mat[2, 2] > 0.5
    first = rows
    for row in range(rows):
        ahead, step = _ray(mat, focal_px, row + 0.5, rows, columns)
        _backdrop_row(
            _nearness(walls_m[0] - pos[0]),
            _nearness(walls_m[1] - pos[0]),
            _nearness(walls_m[2] - pos[1]),
            _nearness(walls_m[3] - pos[1]),
            Single(pos[2]),
            Single(pos[2] - wall_height_m),
            wall_greys,
            Single(sky_grey),
            Single(focal_px / _EDGE_BLUR),
            ahead,
            step,
            behind[row],
            share[row],
        )
        if first == rows and min(ahead[2], ahead[2] + columns * step[2]) < 1.0 / focal_px:
            for column in range(columns):
                if share[row, column] > 0.0:
                    first = row
                    break
        # The floor is convex and so is its image: a row with both ends on the floor lies on it.
        if inside and upright and share[row, 0] >= 1.0 and share[row, -1] >= 1.0:
            return min(first, row), row
    return first, rows


@kernel
def _ray(
    mat: Floats, focal_px: float, height_px: float, rows: int, columns: int
) -> tuple[Vector, Vector]:
    """World direction, of depth 1, through the leftmost pixel centre, and its change per column.

    `height_px` counts downwards from the upper edge of the frame.
    """
    left = (0.5 * columns - 0.5) / focal_px
    up = (0.5 * rows - height_px) / focal_px
    return (
        (
            mat[0, 0] + left * mat[0, 1] + up * mat[0, 2],
            mat[1, 0] + left * mat[1, 1] + up * mat[1, 2],
            mat[2, 0] + left * mat[2, 1] + up * mat[2, 2],
        ),
        (-mat[0, 1] / focal_px, -mat[1, 1] / focal_px, -mat[2, 1] / focal_px),
    )


@kernel
def _nearness(distance_m: float) -> Single:
    """One over the signed distance of a wall."""
    return Single(1.0 / distance_m) if abs(distance_m) > 1e-6 else Single(1e6)


@kernel
def _backdrop_row(
    near_low_x: Single,
    near_high_x: Single,
    near_low_y: Single,
    near_high_y: Single,
    over_floor: Single,
    over_walls: Single,
    wall_greys: Singles,
    sky_grey: Single,
    sharpness: Single,
    ahead: Vector,
    step: Vector,
    behind: Singles,
    share: Singles,
) -> None:
    """One row of `_backdrop`. Works with one over the depth of a wall, and so without division."""
    zero, half, one = Single(0.0), Single(0.5), Single(1.0)
    ahead_x, ahead_y, ahead_z = Single(ahead[0]), Single(ahead[1]), Single(ahead[2])
    step_x, step_y, step_z = Single(step[0]), Single(step[1]), Single(step[2])
    grey_low_x, grey_high_x = wall_greys[0], wall_greys[1]
    grey_low_y, grey_high_y = wall_greys[2], wall_greys[3]
    for column in range(len(behind)):
        # By way of 32 bits: numba counts in 64, which few processors turn into floats by vectors.
        c = Single(np.int32(column))
        x, y, z = ahead_x + c * step_x, ahead_y + c * step_y, ahead_z + c * step_z
        near_x = x * (near_high_x if x > zero else near_low_x)
        near_y = y * (near_high_y if y > zero else near_low_y)
        grey_x = grey_high_x if x > zero else grey_low_x
        grey_y = grey_high_y if y > zero else grey_low_y
        grey = grey_x if near_x > near_y else grey_y
        near = max(near_x, near_y, zero)
        sky = min(max(half + (over_walls * near + z) * sharpness, zero), one)
        behind[column] = grey + sky * (sky_grey - grey)
        share[column] = min(max(half - (over_floor * near + z) * sharpness, zero), one)


@kernel
def _floor(
    texels: Words,
    levels: Ints,
    grid: Floats,
    palette: Pixels,
    focal_px: float,
    bias: float,
    pos: Floats,
    mat: Floats,
    behind: Singles,
    share: Singles,
    first: int,
    clear: int,
    frame: Pixels,
) -> None:
    """Draw the ground into the rows from `first` on; above `clear` it shares them with `behind`."""
    rows, columns = frame.shape
    at = np.empty(columns, np.int32)
    between = np.empty(columns, np.int32)
    words = np.empty(columns, np.uint32)
    sums = np.zeros((2, columns), np.float32)
    lens_height_m = min(max(pos[2], 1e-3), 10.0)
    for row in range(first - 1, rows):
        # Sample lines lie between the centres of this row and the next. Each counts for both, by
        # nearness: that is the tent filter.
        here, below = sums[row & 1], sums[(row + 1) & 1]
        below[:] = Single(0.0)
        index, lines = _sampling(mat, focal_px, row + 1.0, rows, lens_height_m, grid[2], levels)
        texel_m = grid[2] * (1 << index)
        x = 256.0 * ((pos[0] - grid[0]) / texel_m - 0.5)
        y = 256.0 * ((pos[1] - grid[1]) / texel_m - 0.5)
        for line in range(lines):
            part = (line + 0.5) / lines
            ahead, step = _ray(mat, focal_px, row + 0.5 + part, rows, columns)
            _aim(
                Single(min(max(x, -_FURTHEST), _FURTHEST)),
                Single(min(max(y, -_FURTHEST), _FURTHEST)),
                Single(-256.0 * lens_height_m / texel_m),
                ahead,
                step,
                levels[index],
                at,
                between,
            )
            _fetch(texels, at, words)
            if len(palette) > 0:
                _recolour(words, palette)
            weight = 1.0 / (65536.0 * lines)
            _blend(
                words, between, Single(weight - part * weight), Single(part * weight), here, below
            )
        if row >= clear:
            _store(here, bias, frame[row])
        elif row >= first:
            _store_before(here, behind[row], share[row], bias, frame[row])


@kernel
def _sampling(
    mat: Floats,
    focal_px: float,
    height_px: float,
    rows: int,
    lens_height_m: float,
    texel_m: float,
    levels: Ints,
) -> tuple[int, int]:
    """Copy of the ground picture and number of sample lines that suit the middle of a pixel row."""
    up = (0.5 * rows - height_px) / focal_px
    x, y = mat[0, 0] + up * mat[0, 2], mat[1, 0] + up * mat[1, 2]
    fall = max(-(mat[2, 0] + up * mat[2, 2]), _LEAST_FALL)
    across_m = lens_height_m / fall / focal_px
    lean = mat[2, 2] / fall
    down_m = across_m * math.hypot(mat[0, 2] + lean * x, mat[1, 2] + lean * y)
    wanted_m = max(_SHARPNESS * across_m, down_m / (_LINE_GAP * _MOST_LINES))
    index = min(max(math.floor(math.log2(wanted_m / texel_m) + 0.5), 0), len(levels) - 1)
    lines = math.ceil(down_m / (_LINE_GAP * texel_m * (1 << index)))
    return index, min(max(lines, 1), _MOST_LINES)


@kernel
def _aim(
    origin_x: Single,
    origin_y: Single,
    to_texels: Single,
    ahead: Vector,
    step: Vector,
    level: Ints,
    at: Ints,
    between: Ints,
) -> None:
    """Find the word that each pixel of a sample line meets, and the place between its texels.

    Places are in 256ths. This, `_fetch` and `_blend` are three loops because the first and the last
    then compile to vector instructions, which the scattered reads of the second would prevent.
    """
    first, pitch = level[0], level[1]
    zero, least = np.int32(0), Single(-_LEAST_FALL)
    last_x, last_y = np.int32(256 * (level[2] - 1)), np.int32(256 * (level[3] - 1))
    ahead_x, step_x = to_texels * Single(ahead[0]), to_texels * Single(step[0])
    ahead_y, step_y = to_texels * Single(ahead[1]), to_texels * Single(step[1])
    ahead_z, step_z = Single(ahead[2]), Single(step[2])
    for column in range(len(at)):
        c = Single(np.int32(column))
        # Not `/`, whose test for zero would keep this loop from becoming vector instructions.
        depth = np.divide(Single(1.0), min(ahead_z + c * step_z, least))
        x = min(max(np.int32(origin_x + depth * (ahead_x + c * step_x)), zero), last_x)
        y = min(max(np.int32(origin_y + depth * (ahead_y + c * step_y)), zero), last_y)
        at[column] = first + (y >> np.int32(8)) * pitch + (x >> np.int32(8))
        between[column] = (x & np.int32(255)) << np.int32(8) | y & np.int32(255)


@kernel
def _fetch(texels: Words, at: Ints, words: Words) -> None:
    for column in range(len(at)):
        words[column] = texels[np.uint32(at[column])]


@kernel
def _recolour(words: Words, palette: Pixels) -> None:
    """Put the palette's greys in the place of those of a word's four texels."""
    byte = np.uint32(255)
    for column in range(len(words)):
        word = words[column]
        words[column] = (
            np.uint32(palette[word & byte])
            | np.uint32(palette[word >> np.uint32(8) & byte]) << np.uint32(8)
            | np.uint32(palette[word >> np.uint32(16) & byte]) << np.uint32(16)
            | np.uint32(palette[word >> np.uint32(24)]) << np.uint32(24)
        )


@kernel
def _blend(
    words: Words,
    between: Ints,
    weight_here: Single,
    weight_below: Single,
    here: Singles,
    below: Singles,
) -> None:
    """Add the blend of each word's four texels, in 65536ths of a grey, to two rows of sums."""
    whole, pair, low = np.uint32(256), np.uint32(0x00FF00FF), np.uint32(0xFFFF)
    for column in range(len(words)):
        word = words[column]
        right = np.uint32(between[column] >> np.int32(8))
        up = np.uint32(between[column] & np.int32(255))
        # Two products at once: the left texels in the low half, the right ones in the high half.
        mixed = (word & pair) * (whole - up) + (word >> np.uint32(8) & pair) * up
        blend = (mixed & low) * (whole - right) + (mixed >> np.uint32(16)) * right
        grey = Single(np.int32(blend))
        here[column] += weight_here * grey
        below[column] += weight_below * grey


@kernel
def _store(greys: Singles, bias: float, pixels: Pixels) -> None:
    more = Single(bias)
    for column in range(len(pixels)):
        pixels[column] = np.uint8(np.int32(greys[column] + more))


@kernel
def _store_before(
    greys: Singles, behind: Singles, share: Singles, bias: float, pixels: Pixels
) -> None:
    more = Single(bias)
    for column in range(len(pixels)):
        grey = behind[column] + share[column] * (greys[column] - behind[column])
        pixels[column] = np.uint8(np.int32(grey + more))


@kernel
def _cuboids(
    boxes: Singles,
    light: Singles,
    focal_px: float,
    bias: float,
    pos: Floats,
    mat: Floats,
    glow: Singles,
    share: Singles,
    frame: Pixels,
) -> None:
    """Draw cuboids over a frame, the furthest first; rows as in `solids.BOX_COLUMNS`.

    The visible sides of one cuboid are summed up in `glow` and `share` before they cover the frame,
    so that nothing shines through where two of them meet.
    """
    away_m = np.hypot(boxes[:, 0] - pos[0], boxes[:, 1] - pos[1])
    corners, polygon = np.empty((4, 3)), np.empty((5, 2))
    for k in np.argsort(-away_m):
        box = boxes[k]
        first, last, left, right = _extent(box, focal_px, pos, mat, frame.shape)
        if first >= last or left >= right:
            continue
        for row in range(first, last):
            glow[row, left:right] = Single(0.0)
            share[row, left:right] = Single(0.0)
        for side in range(5):
            lambert = _side_of(box, side, pos, corners)
            if lambert < 0.0:
                continue
            count = _project(corners, focal_px, pos, mat, frame.shape, polygon)
            grey = 0.0
            for c in range(3):
                grey += box[8 + c] * (light[c] + light[3 + c] * lambert)
            _fill(polygon[:count], min(grey, 255.0), first, last, glow, share)
        for row in range(first, last):
            _cover(glow[row, left:right], share[row, left:right], bias, frame[row, left:right])


@kernel
def _extent(
    box: Singles, focal_px: float, pos: Floats, mat: Floats, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """First and past the last row, then column, that a cuboid can touch: none behind the lens."""
    rows, columns = shape
    top, bottom, left, right, before = np.inf, -np.inf, np.inf, -np.inf, 0
    for corner in range(8):
        along = box[4] if corner & 1 else -box[4]
        across = box[5] if corner & 2 else -box[5]
        x = box[0] + box[2] * along - box[3] * across - pos[0]
        y = box[1] + box[3] * along + box[2] * across - pos[1]
        z = (box[7] if corner & 4 else box[6]) - pos[2]
        depth = x * mat[0, 0] + y * mat[1, 0] + z * mat[2, 0]
        if depth > _NEAR_M:
            row = 0.5 * rows - focal_px * (x * mat[0, 2] + y * mat[1, 2] + z * mat[2, 2]) / depth
            aside = x * mat[0, 1] + y * mat[1, 1] + z * mat[2, 1]
            column = 0.5 * columns - focal_px * aside / depth
            top, bottom, before = min(top, row), max(bottom, row), before + 1
            left, right = min(left, column), max(right, column)
    if before == 0:
        return 0, 0, 0, 0
    if before < 8:  # it reaches behind the lens: how far to the edges cannot be told from corners
        return 0, rows, 0, columns
    return (
        max(int(min(max(top, 0.0), float(rows))) - 1, 0),
        min(int(max(min(bottom, float(rows)), -2.0)) + 2, rows),
        max(int(min(max(left, 0.0), float(columns))) - 2, 0),
        min(int(max(min(right, float(columns)), -3.0)) + 3, columns),
    )


@kernel
def _side_of(box: Singles, side: int, pos: Floats, corners: Floats) -> float:
    """Corners of one of the five sides, bottom left out, and how directly the sun meets it.

    Returns:
        Cosine of the angle to the sun, 0 in the shade; -1 for a side that the lens cannot see.
    """
    cos, sin = box[2], box[3]
    half_x, half_y = box[4], box[5]
    if side == 4:
        if pos[2] <= box[7]:
            return -1.0
        for corner in range(4):
            along = half_x if corner == 1 or corner == 2 else -half_x
            across = half_y if corner >= 2 else -half_y
            corners[corner, 0] = box[0] + cos * along - sin * across
            corners[corner, 1] = box[1] + sin * along + cos * across
            corners[corner, 2] = box[7]
        return _SUN[2]
    # Sides 0 and 1 look forward and back, 2 and 3 to the left and right.
    sign = 1.0 if side % 2 == 0 else -1.0
    if side < 2:
        normal_x, normal_y, out, half = sign * cos, sign * sin, half_x, half_y
    else:
        normal_x, normal_y, out, half = -sign * sin, sign * cos, half_y, half_x
    middle_x, middle_y = box[0] + normal_x * out, box[1] + normal_y * out
    if (pos[0] - middle_x) * normal_x + (pos[1] - middle_y) * normal_y <= 0.0:
        return -1.0
    for corner in range(4):
        shift = half if corner == 1 or corner == 2 else -half
        corners[corner, 0] = middle_x - normal_y * shift
        corners[corner, 1] = middle_y + normal_x * shift
        corners[corner, 2] = box[7] if corner >= 2 else box[6]
    facing: float = normal_x * _SUN[0] + normal_y * _SUN[1]
    return max(facing, 0.0)


@kernel
def _project(
    corners: Floats,
    focal_px: float,
    pos: Floats,
    mat: Floats,
    shape: tuple[int, int],
    polygon: Floats,
) -> int:
    """The image of a side, columns and rows in pixels, cut off at the near plane of the lens.

    Returns:
        How many corners it has, at most 5; 0 where nothing is left of it.
    """
    seen = np.empty((4, 3))
    for k in range(4):
        x, y, z = corners[k, 0] - pos[0], corners[k, 1] - pos[1], corners[k, 2] - pos[2]
        for axis in range(3):
            seen[k, axis] = x * mat[0, axis] + y * mat[1, axis] + z * mat[2, axis]
    count = 0
    for k in range(4):
        here, following = seen[k], seen[(k + 1) % 4]
        if here[0] >= _NEAR_M:
            polygon[count, 0] = 0.5 * shape[1] - focal_px * here[1] / here[0]
            polygon[count, 1] = 0.5 * shape[0] - focal_px * here[2] / here[0]
            count += 1
        if (here[0] >= _NEAR_M) != (following[0] >= _NEAR_M):
            part = (_NEAR_M - here[0]) / (following[0] - here[0])
            left = here[1] + part * (following[1] - here[1])
            up = here[2] + part * (following[2] - here[2])
            polygon[count, 0] = 0.5 * shape[1] - focal_px * left / _NEAR_M
            polygon[count, 1] = 0.5 * shape[0] - focal_px * up / _NEAR_M
            count += 1
    return count


@kernel
def _fill(
    polygon: Floats, grey: float, first: int, last: int, glow: Singles, share: Singles
) -> None:
    """Add a convex polygon to the sums of rows `first` to `last`, with the tent filter."""
    count = len(polygon)
    if count < 3:
        return
    columns = glow.shape[1]
    top, bottom = polygon[:, 1].min(), polygon[:, 1].max()
    begin = max(
        int(np.floor(max(top, first - 1.0) * _LINES_PER_PIXEL)), (first - 1) * _LINES_PER_PIXEL
    )
    end = min(
        int(np.ceil(min(bottom, last + 1.0) * _LINES_PER_PIXEL)), (last + 1) * _LINES_PER_PIXEL
    )
    for line in range(begin, end):
        y = (line + 0.5) / _LINES_PER_PIXEL
        left, right = np.inf, -np.inf
        for k in range(count):
            ax, ay = polygon[k]
            bx, by = polygon[(k + 1) % count]
            if (ay <= y) != (by <= y):
                x = ax + (y - ay) / (by - ay) * (bx - ax)
                left, right = min(left, x), max(right, x)
        if left >= right or right < -1.0 or left > columns + 1.0:
            continue
        row = int(np.floor(y - 0.5))
        part = y - 0.5 - row
        low = max(int(max(left, 0.0) - 1.5), 0)
        high = min(int(min(right, float(columns)) + 2.5), columns)
        for near, weight in ((row, 1.0 - part), (row + 1, part)):
            if first <= near < last:
                _add_span(
                    Single(left),
                    Single(right),
                    Single(weight / _LINES_PER_PIXEL),
                    Single(grey),
                    low,
                    high,
                    glow[near],
                    share[near],
                )


@kernel
def _add_span(
    left: Single,
    right: Single,
    weight: Single,
    grey: Single,
    low: int,
    high: int,
    glow: Singles,
    share: Singles,
) -> None:
    """Add what the tent filter makes of a line between two columns."""
    half, one = Single(0.5), Single(1.0)
    for column in range(low, high):
        middle = Single(np.int32(column)) + half
        in_left = min(max(middle - left, -one), one)
        in_right = min(max(middle - right, -one), one)
        # The integral of a tent from one end up to the middle of the pixel, at both ends.
        part = weight * (
            in_left - half * in_left * abs(in_left) - in_right + half * in_right * abs(in_right)
        )
        share[column] += part
        glow[column] += grey * part


@kernel
def _cover(glow: Singles, share: Singles, bias: float, pixels: Pixels) -> None:
    """Put the sums of a cuboid over a row of the frame."""
    one, more, little = Single(1.0), Single(bias), Single(1e-4)
    for column in range(len(pixels)):
        covered = share[column]
        if covered > little:
            whole = max(covered, one)
            open_share = one - min(covered, one)
            grey = Single(pixels[column]) * open_share + glow[column] / whole
            pixels[column] = np.uint8(np.int32(min(grey + more, Single(255.0))))
