"""Light sources, one module for each kind of the config: what it builds, what a surface gets from it, and what the
renderer, the truth and the reference engine need to know of it.

`source` says what every source must answer; `table` names the kinds. The keys of each kind are a section of
`configs.lights`.
"""
