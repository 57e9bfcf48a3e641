"""Light sources, with one module for each kind of light in a config.

``source`` has the interface of all sources, and ``table`` the list of kinds. The keys of each kind are in a section of
``configs.lights``.
"""
