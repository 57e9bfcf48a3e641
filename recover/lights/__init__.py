"""The lights, from one picture.

``model`` says what a light is and which matrix pixels without it have. One by one: ``from_shadows`` (with
``one_light``) finds each light by the pixels that miss it. All together, in noise: ``search`` asks ``lit_surface``,
which starts from an ``irradiance_map`` and ends in ``bundle_adjustment``. Known positions: ``near_lights``.
"""
