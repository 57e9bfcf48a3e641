"""Which pixels may take part, and how much of their colour is noise.

In order: ``usable`` chooses the pixels; ``noise`` measures their noise; ``rank`` tells how many dimensions the colours
of a patch span; ``uncertain_component`` weighs colours of which one component is known less well than the others. Tuned
numbers: ``parameters``.
"""
