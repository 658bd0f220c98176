"""The pictures of `drsim.viewing.world_view`, made by MuJoCo's renderer, which needs OpenGL."""

import math
import os
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from drsim.arrays import RGB, Bytes, Floats
from drsim.track.appearance import Look, look_of
from drsim.track.track import Track
from drsim.viewing.car_eye import lens_above
from drsim.viewing.placed_objects import (
    BLACK,
    GLASS,
    LAMP,
    PAINT,
    RIM,
    STRIPED,
    TAIL,
    TYRE,
    Kinds,
    Mesh,
    PlacedObject,
    color_of,
    meshes_of,
    placed,
)
from drsim.viewing.world_view import GHOST_OPACITY, Lens, WorldView

_TEXTURE = 2048
_FIELD_M = 60.0
_COLORS: dict[int, tuple[float, float, float]] = {
    GLASS: (0.05, 0.06, 0.08),
    TYRE: (0.08, 0.08, 0.085),
    RIM: (0.70, 0.71, 0.74),
    BLACK: (0.09, 0.09, 0.10),
    LAMP: (1.0, 0.98, 0.88),
    TAIL: (0.93, 0.10, 0.08),
}
_GLOSSY = (PAINT, STRIPED, GLASS)


class RendererError(RuntimeError):
    """MuJoCo cannot draw here."""


class MujocoView:
    """Makes frames of one track with OpenGL. Shape (rows, columns, 3), uint8."""

    def __init__(
        self, track: Track, *, columns: int = 640, rows: int = 480, look: Look | None = None
    ) -> None:
        """Paint the ground and start OpenGL.

        Raises:
            RendererError: There is no OpenGL.
        """
        try:
            self._opengl: Any = _opengl(columns, rows)
        except Exception as error:  # each platform and driver has errors of its own
            raise RendererError(f"OpenGL cannot be started: {error}.") from None
        self.size = (rows, columns)
        self._track = track
        self._look = look or look_of(track.name)
        self._ground, self._ground_m, self._middle = _ground_picture(track, self._look)
        self._kinds: Kinds | None = None
        self._context: Any = None

    def frame(self, lens: Lens, things: Sequence[PlacedObject]) -> Bytes:
        """Picture some things on the track.

        Raises:
            RendererError: There is no OpenGL.
        """
        ordered = sorted(things, key=lambda thing: thing.ghost)
        kinds = tuple((thing.shape, thing.color, thing.ghost) for thing in ordered)
        if kinds != self._kinds:
            self._build(kinds)
        turns, shifts = placed(ordered)
        for part in range(len(turns)):
            self._data.mocap_pos[part] = shifts[part]
            mujoco.mju_mat2Quat(self._data.mocap_quat[part], turns[part].ravel())
        mujoco.mj_forward(self._model, self._data)
        self._aim(lens)
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            mujoco.MjvOption(),
            None,
            self._camera,
            mujoco.mjtCatBit.mjCAT_ALL,
            self._scene,
        )
        rows, columns = self.size
        window = mujoco.MjrRect(0, 0, columns, rows)
        picture = np.empty((rows, columns, 3), np.uint8)
        self._opengl.make_current()
        mujoco.mjr_render(window, self._scene, self._context)
        mujoco.mjr_readPixels(picture, None, window, self._context)
        return np.ascontiguousarray(picture[::-1])

    def close(self) -> None:
        self._drop_context()
        if self._opengl is not None:
            self._opengl.free()
            self._opengl = None

    def _drop_context(self) -> None:
        if self._context is not None:
            self._opengl.make_current()
            self._context.free()
            self._context = None

    def _aim(self, lens: Lens) -> None:
        rows, columns = self.size
        across = math.tan(0.5 * lens.field_of_view_rad)
        forward, left, up = lens.mat.T
        # MuJoCo's cameras look along their negative z axis, with x to the right and y up.
        turn = np.stack([-left, up, -forward], axis=1)
        self._data.cam_xpos[0] = lens.pos
        self._data.cam_xmat[0] = turn.ravel()
        self._model.cam_fovy[0] = math.degrees(2.0 * math.atan(across * rows / columns))

    def _build(self, kinds: Kinds) -> None:
        self._drop_context()
        spec = mujoco.MjSpec()
        rows, columns = self.size
        spec.visual.global_.offwidth, spec.visual.global_.offheight = columns, rows
        spec.visual.quality.shadowsize = 4096
        spec.visual.headlight.ambient = [0.38, 0.40, 0.44]
        spec.visual.headlight.diffuse = [0.12, 0.12, 0.12]
        spec.visual.map.znear = 0.001
        spec.stat.extent = 20.0
        world = spec.worldbody
        world.add_light(
            pos=[0, 0, 10],
            dir=[-0.5, 0.1, -0.9],
            diffuse=[0.65, 0.63, 0.58],
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            castshadow=True,
        )
        world.add_camera(name="film", pos=[0, 0, 1])
        spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.80, 0.87, 0.94],
            rgb2=[0.25, 0.47, 0.80],
            width=256,
            height=1536,
        )
        self._add_ground(spec, world)
        parts = [(*kind, mesh) for kind in kinds for mesh in meshes_of(kind[0])]
        for number, (shape, color, ghost, mesh) in enumerate(parts):
            body = world.add_body(name=f"part{number}", mocap=True)
            opacity = GHOST_OPACITY if ghost else 1.0
            _add_mesh(spec, body, mesh, f"part{number}", color_of(shape, color), opacity)
        try:
            self._model = spec.compile()
            self._data = mujoco.MjData(self._model)
            self._scene = mujoco.MjvScene(self._model, 2000)
            self._camera = mujoco.MjvCamera()
            self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self._camera.fixedcamid = 0
            self._opengl.make_current()
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        except Exception as error:
            raise RendererError(f"MuJoCo cannot draw here: {error}") from None
        self._kinds = kinds

    def _add_ground(self, spec: Any, world: Any) -> None:
        side = self._ground.shape[0]
        texture = spec.add_texture(
            name="ground", type=mujoco.mjtTexture.mjTEXTURE_2D, width=side, height=side, nchannel=3
        )
        texture.data = self._ground.tobytes()
        material = spec.add_material(name="ground", specular=0.0, reflectance=0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
        half = 0.5 * self._ground_m
        world.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[half, half, 1.0],
            pos=[*self._middle, 0.0],
            material="ground",
            contype=0,
            conaffinity=0,
        )
        field = [channel / 255.0 for channel in self._look.field.rgb]
        world.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[half + _FIELD_M, half + _FIELD_M, 1.0],
            pos=[*self._middle, -0.004],
            rgba=[*field, 1.0],
            contype=0,
            conaffinity=0,
        )


def _opengl(columns: int, rows: int) -> Any:
    """A context without a window, as MUJOCO_GL names: egl or osmesa.

    What mujoco would choose when loaded, the rest of this program switches off.
    """
    kind = os.environ.get("MUJOCO_GL", "").lower()
    if kind == "osmesa":
        from mujoco.osmesa import GLContext
    else:
        from mujoco.egl import GLContext
    return GLContext(columns, rows)


def _ground_picture(track: Track, look: Look) -> tuple[Bytes, float, Floats]:
    view = WorldView(track, columns=_TEXTURE, rows=_TEXTURE, look=look, threads=2)
    try:
        lens = lens_above(track, view.size)
        picture = view.frame(lens, [])
    finally:
        view.close()
    side_m = 2.0 * float(lens.pos[2]) * math.tan(0.5 * lens.field_of_view_rad)
    return picture, side_m, lens.pos[:2].copy()


def _add_mesh(spec: Any, body: Any, mesh: Mesh, name: str, color: RGB, opacity: float) -> None:
    for material in np.unique(mesh.materials).tolist():
        used, renumbered = np.unique(mesh.faces[mesh.materials == material], return_inverse=True)
        key = f"{name}-{material}"
        plain = tuple(channel / 255.0 for channel in color)
        spec.add_mesh(
            name=key,
            uservert=mesh.corners[used].ravel(),
            userface=renumbered.reshape(-1).astype(np.int32),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        gloss = 0.8 if material in _GLOSSY else 0.1
        spec.add_material(
            name=key, specular=gloss, shininess=0.7, emission=0.6 if material == LAMP else 0.0
        )
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=key,
            material=key,
            contype=0,
            conaffinity=0,
            rgba=[*_COLORS.get(material, plain), opacity],
        )
