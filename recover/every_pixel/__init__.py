"""Normals for all pixels of the object, from the matrix F of those that see every light.

``completion`` calls the others in order. ``by_light_sets`` labels each pixel with the set of lights that it misses, and
``by_joint_lights`` does so for lights that were found together with the surface. ``by_irradiance_map`` gives normals
where no set of lights explains the colour.
"""
