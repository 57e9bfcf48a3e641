"""The lights, from one picture: how many there are, where they stand and of what colours they are.

``model`` says what a light is, and which matrix the pixels have that miss some lights. Two ways lead to the lights:

- one by one, ``from_shadows`` finds each by the pixels that miss it (``one_light`` fits a light to them);
- all together, where noise hides single lights: ``search`` calls ``lit_surface`` and decides whether it is believed.
  ``lit_surface`` starts from a surface that an ``irradiance_map`` extends, and ends in a ``bundle_adjustment``.
  The map and the adjustment fit light and depth over ``blocks`` of pixels.

Where the positions of near lights are known, ``near_lights`` fits depth and the lights' colours.
"""
