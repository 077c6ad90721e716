"""The part of CARLA's world that autoware-carla-scenario's SUMO traffic asks, without CARLA.

Cars stand where they were put, or go on with a constant velocity; the physics of CARLA is not
here: a car that is steered does not move. CARLA's frame is left-handed: y points south.
"""

import fnmatch
import math
from types import SimpleNamespace

import numpy as np
from shapely import box
from shapely.affinity import rotate, translate


class Actor:
    """A car."""

    def __init__(self, carla, number, role, transform, size_m=(4.8, 1.9)):
        self.id, self.type_id = number, "vehicle.double"
        self.attributes = {"role_name": role, "base_type": "car"}
        extent = SimpleNamespace(x=size_m[0] / 2, y=size_m[1] / 2, z=0.8)
        self.bounding_box = SimpleNamespace(extent=extent)
        self._carla, self._transform = carla, transform
        self._speed, self.gone = 0.0, False
        self._velocity = (0.0, 0.0)

    def get_transform(self):
        return self._transform

    def set_transform(self, transform):
        self._transform = transform

    def get_velocity(self):
        return self._carla.Vector3D(*self._velocity, 0.0)

    def get_angular_velocity(self):
        return self._carla.Vector3D(0.0, 0.0, 0.0)

    def get_physics_control(self):
        raise RuntimeError("there is no physics here")

    def set_target_velocity(self, velocity):
        pass

    def enable_constant_velocity(self, velocity):
        self._speed = velocity.x

    def disable_constant_velocity(self):
        self._speed = 0.0

    def destroy(self):
        self.gone = True

    def go_on(self, seconds):
        """One tick."""
        yaw = math.radians(self._transform.rotation.yaw)
        self._velocity = (self._speed * math.cos(yaw), self._speed * math.sin(yaw))
        at = self._transform.location
        self._transform.location = self._carla.Location(
            at.x + seconds * self._velocity[0], at.y + seconds * self._velocity[1], at.z
        )

    def box(self):
        """Its box in SUMO's frame, where the network has no offset."""
        at, extent = self._transform.location, self.bounding_box.extent
        own = box(-extent.x, -extent.y, extent.x, extent.y)
        turned = rotate(own, -self._transform.rotation.yaw, origin=(0.0, 0.0))
        return translate(turned, at.x, -at.y)


class Driven(Actor):
    """A car that goes along a line in SUMO's frame with one speed."""

    def __init__(self, carla, number, role, line_m, speed_mps):
        self._line_m = np.asarray(line_m, float)
        self._along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(self._line_m, axis=0).T)))
        self._driven_m, self._mps = 0.0, speed_mps
        super().__init__(carla, number, role, carla.Transform(carla.Location(), carla.Rotation()))
        self.go_on(0.0)

    def go_on(self, seconds):
        self._driven_m += seconds * self._mps
        (x, ahead_x), (y, ahead_y) = (
            np.interp([self._driven_m, self._driven_m + 1.0], self._along_m, row)
            for row in self._line_m.T
        )
        yaw = math.atan2(-(ahead_y - y), ahead_x - x)
        self._velocity = (self._mps * math.cos(yaw), self._mps * math.sin(yaw))
        self._transform = self._carla.Transform(
            self._carla.Location(x, -y, 0.0), self._carla.Rotation(yaw=math.degrees(yaw))
        )


class Found(list):
    """What ``get_actors`` returns."""

    def filter(self, pattern):
        return Found(one for one in self if fnmatch.fnmatch(one.type_id, pattern))


class World:
    """The world; ``tick`` moves all cars."""

    id = None

    def __init__(self, carla, tick_s=0.05):
        self._carla, self.tick_s = carla, tick_s
        self.actors = Found()

    def get_actors(self):
        return Found(one for one in self.actors if not one.gone)

    def get_blueprint_library(self):
        return SimpleNamespace(find=_Blueprint)

    def try_spawn_actor(self, blueprint, transform):
        self.actors.append(Actor(self._carla, len(self.actors) + 1, blueprint.role, transform))
        return self.actors[-1]

    def drive(self, role, line_m, speed_mps):
        """A car that is not of the traffic."""
        self.actors.append(Driven(self._carla, len(self.actors) + 1, role, line_m, speed_mps))
        return self.actors[-1]

    def tick(self):
        for actor in self.get_actors():
            actor.go_on(self.tick_s)


class _Blueprint:
    def __init__(self, name):
        self.name, self.role = name, ""

    def has_attribute(self, name):
        return name == "role_name"

    def set_attribute(self, name, value):
        self.role = value
