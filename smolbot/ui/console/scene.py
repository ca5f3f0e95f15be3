"""The 3-D scene: tank, coils, sensors and path of a mission, and the trace of its robot. In mm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import quaternion_from_matrix
from smolbot.ui.console.meshes import make_circle, make_rectangle, make_ribbon, make_rotation, make_tube, place_vertices

if TYPE_CHECKING:
    from viser import ViserServer

PATH = (37, 99, 235)
TRACKED = (234, 88, 12)
TRUE = (22, 163, 74)
ROBOT = (30, 41, 59)
COPPER = (184, 115, 51)
GLOW = (255, 72, 0)
BOBBIN = (120, 113, 108)
LIQUID = (96, 165, 250)
SENSOR = (71, 85, 105)
PLANNED = (124, 58, 237)

REST_OPACITY = 0.2
"""Opacity of a coil without current, so that what is behind it stays visible."""

Color = tuple[int, int, int]


def mix_colors(a: Color, b: Color, share: float) -> Color:
    """Mix two colours.

    Parameters
    ----------
    a : Color
    b : Color
    share : float
        Share of the second colour, from 0 to 1.

    Returns
    -------
    Color

    Examples
    --------
    >>> mix_colors((0, 0, 0), (100, 200, 50), 0.5)
    (50, 100, 25)
    """
    s = min(max(share, 0.0), 1.0)
    r, g, b_ = (round(p + s * (q - p)) for p, q in zip(a, b, strict=True))
    return (r, g, b_)


class Scene:
    """The objects that viser shows; built anew for each mission, moved with each update of a flight.

    Parameters
    ----------
    server : viser.ViserServer

    Attributes
    ----------
    height : float, in mm
        z of the liquid's surface.
    """

    def __init__(self, server: ViserServer) -> None:
        self.server = server
        self._handles: list[Any] = []
        self._coils: list[Any] = []
        self._robot: Any = None
        self._trails: dict[str, Any] = {}
        self.height = 0.0
        server.scene.set_up_direction("+z")
        server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=False)
        server.scene.configure_environment_map(None)
        camera = server.initial_camera
        camera.position, camera.look_at, camera.up = (0.0, -68.0, 180.0), (0.0, -3.0, 45.0), (0.0, 0.0, 1.0)
        camera.fov = float(np.radians(38.0))
        camera.near, camera.far = 1.0, 5000.0

    def draw(self, mission: AnyMission) -> None:
        """Draw everything that does not move, in place of the last mission.

        Parameters
        ----------
        mission : Mission or Observation
        """
        with self.server.atomic():
            for handle in [*self._handles, *self._trails.values()]:
                handle.remove()
            self._handles, self._coils, self._trails, self._robot = [], [], {}, None
            self._draw_vessel(mission)
            self._draw_coils(mission)
            self._draw_sensors(mission)
            if isinstance(mission, Mission):
                self._draw_path(mission)
            self._draw_robot(mission)

    def _add(self, handle: Any) -> Any:
        self._handles.append(handle)
        return handle

    def _draw_vessel(self, mission: AnyMission) -> None:
        scene, box = self.server.scene, mission.rig.sections.container
        (x, y), (width, depth) = box.center_mm, box.size_mm
        floor, surface, wall = box.floor_z_mm, box.surface_z_mm, 1.5
        self.height = surface
        top = floor + box.wall_height_mm
        vertices, faces = make_tube(
            make_rectangle(width, depth), make_rectangle(width + 2 * wall, depth + 2 * wall), top - floor
        )
        middle = np.array([x, y, 0.5 * (floor + top)])
        add = scene.add_mesh_simple
        self._add(
            add(
                "/tank/walls",
                vertices + middle,
                faces,
                color=(100, 116, 139),
                opacity=0.3,
                flat_shading=True,
                cast_shadow=False,
            )
        )
        self._add(
            scene.add_box(
                "/tank/floor", (226, 232, 240), (width + 2 * wall, depth + 2 * wall, wall),
                position=(x, y, floor - 0.5 * wall), opacity=0.9,
            )
        )  # fmt: skip
        self._add(
            scene.add_box(
                "/tank/liquid", LIQUID, (width, depth, surface - floor),
                position=(x, y, 0.5 * (floor + surface)), opacity=0.16, cast_shadow=False, receive_shadow=False,
            )
        )  # fmt: skip
        self._add(
            scene.add_grid(
                "/floor", 400.0, 400.0, plane="xy", cell_size=10.0, section_size=50.0, cell_color=(226, 232, 240),
                section_color=(148, 163, 184), position=(0.0, 0.0, -5.0), fade_distance=900.0, shadow_opacity=0.0,
            )
        )  # fmt: skip
        self._add(scene.add_frame("/axes", axes_length=15.0, axes_radius=0.5, position=(-90.0, -90.0, -4.0)))

    def _draw_coils(self, mission: AnyMission) -> None:
        scene, rig = self.server.scene, mission.rig.sections
        for coil in rig.coils:
            vertices, faces = make_tube(
                make_circle(coil.inner_radius_mm), make_circle(coil.outer_radius_mm), coil.length_mm
            )
            where = place_vertices(vertices, np.array(coil.center_mm), np.array(coil.axis, dtype=float))
            handle = scene.add_mesh_simple(
                f"/coils/{coil.name}", where, faces, color=COPPER, opacity=REST_OPACITY, flat_shading=True,
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._coils.append(self._add(handle))
            place = np.array(coil.center_mm) + np.array([0.0, 0.0, coil.outer_radius_mm + 4.0])
            self._add(scene.add_label(f"/names/{coil.name}", f"coil {coil.name}", position=tuple(place)))
        for bobbin in rig.excitation:
            inner = make_rectangle(bobbin.width_mm - 4.0, max(bobbin.height_mm - 4.0, 2.0))
            vertices, faces = make_tube(inner, make_rectangle(bobbin.width_mm, bobbin.height_mm), bobbin.length_mm)
            where = place_vertices(vertices, np.array(bobbin.center_mm), np.array(bobbin.axis, dtype=float))
            self._add(
                scene.add_mesh_simple(
                    f"/excitation/{bobbin.name}",
                    where,
                    faces,
                    color=BOBBIN,
                    opacity=0.25,
                    flat_shading=True,
                    cast_shadow=False,
                    receive_shadow=False,
                )
            )
        if rig.magnet is not None:
            side, center = rig.magnet.side_mm, np.array(rig.magnet.center_mm)
            self._add(scene.add_box("/magnet", (185, 28, 28), (side, side, side), position=tuple(center), opacity=0.5))

    def _draw_sensors(self, mission: AnyMission) -> None:
        sensors = mission.rig.sensors
        for i, (place, axis) in enumerate(zip(1e3 * sensors.positions, sensors.axes, strict=True)):
            self._add(
                self.server.scene.add_cylinder(
                    f"/sensors/{i}", 2.0, 10.0, color=SENSOR, position=tuple(place),
                    wxyz=tuple(quaternion_from_matrix(make_rotation(axis))), cast_shadow=False, receive_shadow=False,
                )
            )  # fmt: skip

    def _draw_path(self, mission: Mission) -> None:
        points = 1e3 * mission.path.points
        points = points - np.array([0.0, 0.0, 0.9])  # under the robot's trace, which would be hidden where it is good
        spread = 1e3 * mission.path.at(np.linspace(0.0, mission.path.length, 400))
        vertices, faces = make_ribbon(spread - np.array([0.0, 0.0, 1.0]), 1e3 * mission.tolerance)
        self._add(
            self.server.scene.add_mesh_simple(
                "/path/tolerance",
                vertices,
                faces,
                color=PATH,
                opacity=0.18,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        )
        self._add(self._make_line("/path/line", points, PATH, 3.0))
        self._add(self.server.scene.add_icosphere("/path/start", 0.7, color=PATH, position=tuple(points[0])))

    def _draw_robot(self, mission: AnyMission) -> None:
        """Draw a body with an arrow ahead; it is hidden until the robot is located."""
        scene, robot = self.server.scene, mission.robot
        self._robot = self._add(scene.add_frame("/robot", show_axes=False, visible=False))
        section = robot.sections.body
        size = (3.0, 3.0, 3.0) if section is None else section.size_mm
        center = (0.0, 0.0, 0.0) if section is None else section.center_mm
        if robot.kind == "helical":
            vertices, faces = make_tube(make_circle(0.05), make_circle(0.5 * size[0]), size[2])
            scene.add_mesh_simple("/robot/body", vertices + np.array(center), faces, color=ROBOT)
        else:
            scene.add_box("/robot/body", ROBOT, size, position=center)
        nose = 0.5 * size[2] + 2.5
        tip, faces = make_tube(make_circle(0.01), make_circle(0.9), 0.01)
        n = len(tip) // 4
        tip[n : 3 * n] = [0.0, 0.0, 2.5]
        tip[:, 2] += nose - 2.0
        scene.add_mesh_simple("/robot/nose", tip, faces, color=TRACKED, side="double")

    def _make_line(self, name: str, points: FloatArray, color: Color, width: float) -> Any:
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        return self.server.scene.add_line_segments(name, pieces, color, thickness=width, thickness_units="screen")

    def draw_line(self, name: str, points: FloatArray, color: Color, width: float = 3.0) -> None:
        """Draw a line in place of the one with the same name.

        Parameters
        ----------
        name : str
        points : ndarray, shape (n, 3), in mm
        color : Color
        width : float
            In pixels.
        """
        before = self._trails.pop(name, None)
        if len(points) > 1:
            self._trails[name] = self._make_line(f"/trails/{name}", points, color, width)
        elif before is not None:
            before.remove()

    def place_robot(self, position: FloatArray | None, orientation: FloatArray | None) -> None:
        """Move the robot to its tracked pose.

        Parameters
        ----------
        position : ndarray, shape (3,), in mm, or None
            None if it is not known; the robot is then hidden.
        orientation : ndarray, shape (4,), or None
            Unit quaternion, scalar first, from body to world.
        """
        if self._robot is None:
            return
        self._robot.visible = position is not None
        if position is not None and orientation is not None:
            self._robot.position, self._robot.wxyz = tuple(position), tuple(orientation)

    def color_coils(self, shares: FloatArray) -> None:
        """Colour the coils by their currents.

        Parameters
        ----------
        shares : ndarray, shape (n_coils,)
            Currents over the highest allowed one.
        """
        for handle, share in zip(self._coils, np.abs(shares), strict=False):
            color = mix_colors(COPPER, GLOW, float(share))
            if tuple(handle.color) != color:
                handle.color = color
                handle.opacity = REST_OPACITY + 0.4 * min(float(share), 1.0)

    def mark(self, name: str, points: FloatArray, color: Color) -> None:
        """Draw dots in place of those with the same name.

        Parameters
        ----------
        name : str
        points : ndarray, shape (n, 3), in mm
        color : Color
        """
        key = f"{name} dots"
        before = self._trails.pop(key, None)
        if before is not None:
            before.remove()
        if len(points):
            self._trails[key] = self.server.scene.add_point_cloud(
                f"/dots/{name}", points.astype("float32"), color, point_size=1.2, point_shape="circle"
            )
