"""highway-env's viewer, extended by double yellow lines, curbs, routes and the destination."""

import numpy as np
import pygame
from highway_env.envs.common.graphics import EnvViewer, ObservationGraphics
from highway_env.road.graphics import RoadGraphics, WorldSurface
from numpy.typing import NDArray

from behavexplor.data.roadmap import DOUBLE_YELLOW

Floats = NDArray[np.float64]

YELLOW, CURB, DESTINATION = (240, 190, 40), (225, 225, 225), (80, 220, 100)
EGO, NPCS = (
    (80, 220, 100),
    ((240, 120, 90), (110, 170, 250), (220, 140, 230), (120, 215, 215), (240, 205, 110), (190, 190, 190)),
)
LINE_WIDTH = 0.15  # [m]
DOUBLE_LINE_GAP = 0.15  # distance of either line from the middle [m]


class MapViewer(EnvViewer):  # type: ignore[misc]
    """Viewer that draws the road, then the illegal lines, the routes and the destination, then the vehicles."""

    def display(self) -> None:
        """Draw the current state, and show it on the screen if there is one."""
        if not self.enabled:
            return
        surface = self.sim_surface
        surface.move_display_window_to(self.window_position())
        RoadGraphics.display(self.env.road, surface)
        self._draw_lines(surface)
        self._draw_routes(surface)
        RoadGraphics.display_traffic(
            self.env.road, surface, simulation_frequency=self.env.config["simulation_frequency"], offscreen=True
        )
        ObservationGraphics.display(self.env.observation_type, surface)
        if not self.offscreen:
            self.screen.blit(surface, (0, 0))
            if self.env.config["real_time_rendering"]:
                self.clock.tick(self.env.config["simulation_frequency"])
            pygame.display.flip()

    def _draw_lines(self, surface: WorldSurface) -> None:
        roadmap = self.env.logical.roadmap
        for (start, end), kind in zip(roadmap.illegal_lines, roadmap.line_kinds, strict=True):
            if kind != DOUBLE_YELLOW:
                _draw_line(surface, CURB, start, end)
                continue
            along = (end - start) / np.hypot(*(end - start))
            aside = DOUBLE_LINE_GAP * np.array([-along[1], along[0]])
            for shift in (aside, -aside):
                _draw_line(surface, YELLOW, start + shift, end + shift)

    def _draw_routes(self, surface: WorldSurface) -> None:
        roadmap = self.env.logical.roadmap
        self.env.vehicle.color = EGO
        for i, npc in enumerate(self.env.scenario.npcs):
            color = NPCS[i % len(NPCS)]
            self.env.road.vehicles[1 + i].color = color
            end = npc.waypoints[-1].position
            points = roadmap.routes[npc.route].polyline(npc.waypoints[0].position, end)
            pygame.draw.lines(surface, color, False, [surface.vec2pix(point) for point in points])
        points = [roadmap.start_pose[:2], *roadmap.ego_route.polyline(roadmap.ego_start, roadmap.destination)[1:]]
        pygame.draw.lines(surface, EGO, False, [surface.vec2pix(point) for point in points])
        target = surface.vec2pix(roadmap.destination_point)
        pygame.draw.circle(surface, DESTINATION, target, max(surface.pix(1.0), 3), width=2)


def _draw_line(surface: WorldSurface, color: tuple[int, int, int], start: Floats, end: Floats) -> None:
    width = max(surface.pix(LINE_WIDTH), 1)
    pygame.draw.line(surface, color, surface.vec2pix(start), surface.vec2pix(end), width)
