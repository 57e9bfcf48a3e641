"""Normals for all pixels of the object, from those that see every light.

``completion`` is the story. ``by_light_sets`` labels each pixel with the lights that it misses; ``by_joint_lights``
does so for lights that were found together with the surface; ``by_irradiance_map`` serves where no set of lights
does.
"""
